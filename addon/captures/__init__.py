# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Capture sets: what lies on disk between rendering (or a photographer) and reconstruction. No bpy.

A capture set is a folder with `capture.json` and its pictures. Everything in it is untrusted: whatever cannot be used
ends as one `addon.errors.ScanstageError` that names the file and the field.

- `fields`: reads one JSON document with every value checked and every error placed.
- `schema`: what a capture set says, as frozen dataclasses, to and from that JSON.
- `files`: writes whole files or none, keeps paths inside the set.
- `picture_format`: a picture file's size and whether it is whole, from its bytes, before anything decodes it.
- `pictures`: one picture file to linear light and back.
- `store`: the folder: reads and writes `capture.json`.
- `scan`: a capture set as the views in the object frame that methods take.
- `importers`: other people's formats as capture sets.
"""
