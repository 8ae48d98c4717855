# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A small valid source of two pictures for every importer, as text that a test may break."""

import json

import numpy as np

from addon.captures.pictures import write_picture

SIZE = (20, 16)
K = "60 0 9.5 0 61 7.5 0 0 1"
POSE = "1 0 0 0 1 0 0 0 1 0 0 4"
PICTURES = ("view_1.png", "view_2.png")


def opencv_yaml(**matrices):
    """Return a FileStorage of matrices, each given as rows, columns and its numbers; or of whole numbers."""
    nodes = [f"{name}: {matrix}" if isinstance(matrix, int) else
             f"{name}: !!opencv-matrix\n   rows: {matrix[0]}\n   cols: {matrix[1]}\n   dt: d\n   data: [ {', '.join(matrix[2].split())} ]"
             for name, matrix in matrices.items()]
    return "\n".join(["%YAML:1.0", "---", *nodes, ""])


LENS = (1, 5, "-0.1 0 0 0 0")
CAMERA = opencv_yaml(K=(3, 3, K), distortion=LENS, axis_point=(1, 3, "0 0 4"), axis_direction=(1, 3, "0 -1 0"))
LINES = "\n".join(f"view_{n}.png {K} {POSE}" for n in (1, 2))
COLMAP = {"cameras.txt": "# one\n1 OPENCV 20 16 60 61 10 8 -0.1 0 0 0\n",
          "images.txt": "# two lines a picture\n1 1 0 0 0 0 0 4 1 view_1.png\n\n2 0.8 0 0.6 0 1 0 5 1 view_2.png\n\n"}
TUM = {"groundtruth.txt": "# poses\n1 0 0 0 0 0 0 1\n2 1 -2 3 0 0.6 0 0.8\n", "camera.yml": CAMERA,
       "rgb.txt": "# pictures\n1.0 view_1.png\n2.0 view_2.png\n"}
MATRIX = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
NOTES = {"chessboard_inner": [7, 5], "square_mm": 28, "pencil_base_px": [[1, 2], [3, 4]], "shadow_tip_px": [[1, 9], [3, 9]],
         "pencil_height_mm": 130, "reference_rows_px": [5, 11]}
SOURCES = {  # case, which begins with the format: the file that is broken, its text, and the files that stay
    "middlebury": ("x_par.txt", f"2\n{LINES}\n", {}),
    "middlebury box": ("readme.txt", "The bounding box is (0 0 0) (1 1 1)", {"x_par.txt": f"2\n{LINES}\n"}),
    "opencv": ("cameras.yml", opencv_yaml(P_1=(3, 4, "60 0 9.5 38 0 61 7.5 30 0 0 1 4"), P_2=(3, 4, "60 0 9.5 38 0 61 7.5 30 0 0 1 5")), {}),
    "opencv xml": ("cameras.xml", "<?xml version=\"1.0\"?>\n<opencv_storage>\n" + "".join(
        f"<P_{n} type_id=\"opencv-matrix\"><rows>3</rows><cols>4</cols><dt>d</dt>\n<data>60 0 9.5 38 0 61 7.5 30 0 0 1 4</data></P_{n}>\n"
        for n in (1, 2)) + "</opencv_storage>\n", {}),
    "opencv json": ("cameras.json", json.dumps({"K": [60, 0, 9, 0, 61, 7, 0, 0, 1], "frames": [
        {"image": name, "P": {"type_id": "opencv-matrix", "rows": 3, "cols": 4, "dt": "d", "data": [60, 0, 9, 1, 0, 61, 7, 1, 0, 0, 1, 4]}}
        for name in PICTURES]}), {}),
    "colmap": ("images.txt", COLMAP["images.txt"], {"cameras.txt": COLMAP["cameras.txt"]}),
    "colmap cameras": ("cameras.txt", COLMAP["cameras.txt"], {"images.txt": COLMAP["images.txt"]}),
    "transforms": ("transforms.json", json.dumps({"fl_x": 60, "fl_y": 61, "cx": 10, "cy": 8, "w": 20, "h": 16, "k1": -0.1, "frames": [
        {"file_path": name, "transform_matrix": MATRIX} for name in PICTURES]}, indent=1), {}),
    "turntable": ("camera.yml", CAMERA, {}),
    "tum": ("groundtruth.txt", TUM["groundtruth.txt"], {"camera.yml": CAMERA, "rgb.txt": TUM["rgb.txt"]}),
    "tum listing": ("rgb.txt", TUM["rgb.txt"], {"camera.yml": CAMERA, "groundtruth.txt": TUM["groundtruth.txt"]}),
    "bouguet": ("Calib_Results.m", "% made\nfc = [ 60 ; 61 ];\ncc = [ 9.5 ; 7.5 ];\nalpha_c = 0;\nkc = [ -0.1 ; 0 ; 0 ; 0 ; 0 ];\nnx = 20;\n"
                "ny = 16;\nomc_1 = [ 0.1 ; 0 ; 0 ];\nTc_1 = [ 0 ; 0 ; 4 ];\nomc_2 = [ 0 ; 1 ; 0 ];\nTc_2 = [ 0 ; 0 ; 5 ];\n", {}),
    "slstudio": ("calibration.yml", opencv_yaml(
        Kc=(3, 3, K), kc=LENS, Kp=(3, 3, K), kp=LENS, Rp=(3, 3, "1 0 0 0 1 0 0 0 1"), Tp=(3, 1, "1 0 0"), screenResX=2, screenResY=2), {}),
    "desk": ("annotations.json", json.dumps(NOTES), {}),
}
OF_OBJECT = [case for case in SOURCES if case in ("middlebury", "opencv", "colmap", "transforms", "turntable", "tum", "bouguet")]


def write_source(folder, case, content=None, alpha=None):
    """Write the source of a case, with ``content`` in place of the text that may be broken."""
    name, text, others = SOURCES[case]
    pictures = PICTURES + (("view_3.png",) if case == "slstudio" else ())
    for picture in [*pictures, *(f"{part}/view_{n}.png" for part in ("calib", "sweep") for n in (1, 2) if case == "desk")]:
        if not (folder / picture).exists():
            write_picture(folder / picture, np.zeros((*SIZE[::-1], 3)), alpha, bits=8)
    for other, words in others.items():
        (folder / other).write_text(words)
    (folder / name).write_bytes(text.encode() if content is None else content)
    return folder
