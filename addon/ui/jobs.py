# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Long work in a window: as steps that a timer advances, so that Blender stays usable and Esc stops it.

A job is an operator whose `Job.steps` is a generator. Called without a window it runs to its end at once; from a
button each tick of a timer takes one step. Work on arrays runs in a thread (`in_thread`) that never touches Blender:
the generator only looks how far it is.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future
from queue import Empty, SimpleQueue

import bpy
from bpy.app.handlers import persistent

from ..errors import Cancelled, ScanstageError

_TICK = 0.05  # seconds


class _Running:
    """The steps of the job that runs in the window, if one does."""

    steps: Iterator[tuple[float, str]] | None = None


_running = _Running()


class MainThread:
    """Lets a thread have functions called by the thread that runs the generator of `in_thread`: Blender's main one."""

    def __init__(self) -> None:
        self._calls: SimpleQueue = SimpleQueue()

    def calling(self, function: Callable) -> Callable:
        """Return a function for the worker that has ``function`` called there, and waits for what it returns or raises."""
        def call(*args):
            answer = Future()
            self._calls.put((answer, function, args))
            return answer.result()
        return call

    def wake(self) -> None:
        """End the wait of `serve`."""
        self._calls.put(None)

    def serve(self, timeout: float) -> None:
        """Make the next call that the worker asks for, if it does within ``timeout`` seconds."""
        request = self._next(timeout)
        if request is None:
            return
        answer, function, args = request
        try:
            answer.set_result(function(*args))
        except BaseException as error:  # noqa: BLE001 - raised again in the worker, which asked for it
            answer.set_exception(error)

    def refuse(self, timeout: float) -> None:
        """Answer the next call, if one comes within ``timeout`` seconds, with `Cancelled`."""
        request = self._next(timeout)
        if request is not None:
            request[0].set_exception(Cancelled())

    def _next(self, timeout: float) -> tuple[Future, Callable, tuple] | None:
        try:
            return self._calls.get(timeout=timeout)
        except Empty:
            return None


def in_thread(function: Callable, *args, main: MainThread | None = None, **keywords) -> Generator[tuple[float, str], None, object]:
    """Run ``function(*args, progress=..., **keywords)`` in a thread; yield its progress and return its result.

    What the function has called through ``main`` is called by this generator, between two steps.
    Closing the generator makes the function's next progress report raise `Cancelled`, and waits for it to end.
    """
    main = main or MainThread()
    latest, outcome, stop = [(0.0, "Starting")], {}, threading.Event()

    def progress(fraction: float, message: str) -> None:
        latest[0] = (fraction, message)
        if stop.is_set():
            raise Cancelled

    def run() -> None:
        try:
            outcome["result"] = function(*args, progress=progress, **keywords)
        except BaseException as error:  # noqa: BLE001 - raised again below, in the thread that started this one
            outcome["error"] = error
        finally:
            main.wake()

    worker = threading.Thread(target=run, name=f"scanstage {function.__name__}", daemon=True)
    worker.start()
    try:
        while worker.is_alive():
            yield latest[0]
            main.serve(_TICK)
    finally:
        stop.set()
        while worker.is_alive():
            main.refuse(_TICK)
    if "error" in outcome:
        raise outcome["error"]
    return outcome["result"]


def idle(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Return whether no job runs; otherwise say so as the reason why the operator's button is greyed out."""
    if context.window_manager.scanstage_job.running:
        operator.poll_message_set("Another Scanstage job is running: wait for it, or press Esc")
        return False
    return True


class Job:
    """Base of operators that run long. A subclass gives ``steps(context)``, a generator of (fraction, message)."""

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        """Yield (fraction, message) after each step of the work."""
        raise NotImplementedError

    def show(self, context: bpy.types.Context) -> None:
        """Bring what the job made to the user's eyes; called in a window only."""

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Run to the end at once."""
        try:
            for _ in self.steps(context):
                pass
        except ScanstageError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        return {'FINISHED'}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start, and let a timer take the steps."""
        self._steps = _running.steps = self.steps(context)
        job = context.window_manager.scanstage_job
        job.running, job.stop, job.operator, job.fraction, job.message = True, False, type(self).bl_idname, 0.0, "Starting"
        self._timer = context.window_manager.event_timer_add(_TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(f"{self.bl_label}: press Esc to stop")
        return {'RUNNING_MODAL'}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Take one step, or stop."""
        job = context.window_manager.scanstage_job
        if job.stop or (event.type == 'ESC' and event.value == 'PRESS'):
            self.cancel(context)
            self.report({'INFO'}, f"{self.bl_label} stopped; what is whole on disk stays")
            return {'CANCELLED'}
        if event.type != 'TIMER':
            return {'PASS_THROUGH'}
        try:
            fraction, message = next(self._steps)
        except StopIteration:
            self._finish(context)
            self.show(context)
            return {'FINISHED'}
        except ScanstageError as error:
            self._finish(context)
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        except BaseException:
            self._finish(context)
            raise
        job.fraction, job.message = fraction, message
        context.workspace.status_text_set(f"{self.bl_label}: {100 * fraction:.0f} %, {message} - press Esc to stop")
        _redraw(context)
        return {'RUNNING_MODAL'}

    def cancel(self, context: bpy.types.Context) -> None:
        """Stop: the generator puts the scene back as it was. Blender calls this too, when the window or file goes."""
        try:
            self._steps.close()
        finally:
            self._finish(context)

    def _finish(self, context: bpy.types.Context) -> None:
        _running.steps = None
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.scanstage_job.running = False
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        _redraw(context)


@persistent
def _before_all_changes(*_) -> None:
    """Stop what runs before undo, or another file, puts other data in the place of all that it holds on to."""
    if _running.steps is not None:
        _running.steps.close()
        bpy.context.window_manager.scanstage_job.stop = True


@persistent
def _after_load(*_) -> None:
    """Forget the job of whoever saved the file while it ran."""
    if _running.steps is None:
        bpy.context.window_manager.scanstage_job.running = False


class SCANSTAGE_OT_stop(bpy.types.Operator):
    """Stop what runs; what is whole on disk stays"""

    bl_idname = "scanstage.stop"
    bl_label = "Stop Scanstage Job"
    bl_options = {'INTERNAL'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.window_manager.scanstage_job.running

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.window_manager.scanstage_job.stop = True
        return {'FINISHED'}


def _redraw(context: bpy.types.Context) -> None:
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == 'VIEW_3D':
                area.tag_redraw()


_HANDLERS = (("undo_pre", _before_all_changes), ("redo_pre", _before_all_changes), ("load_pre", _before_all_changes),
             ("load_post", _after_load))
_register_classes, _unregister_classes = bpy.utils.register_classes_factory((SCANSTAGE_OT_stop,))


def register() -> None:
    """Register the operator, and watch for undo and other files."""
    _register_classes()
    for name, handler in _HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    """Undo `register`."""
    for name, handler in _HANDLERS:
        getattr(bpy.app.handlers, name).remove(handler)
    _unregister_classes()
