"""The photos of a reconstruction: their cameras in the scene, and each candidate as they show it.

A photo is a file below the folder that ingest noted; it may have gone since, and is not shown then.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import rerun as rr
from PIL import Image

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.boxes import boxes_of
from spinpipe.pipeline.drawing.drawing import LOCAL, Reader, at_candidate, clear_stale
from spinpipe.schemas import CALIBRATIONS, CAMERAS, SCENE, UPRIGHT
from spinpipe.schemas.arrays import F64
from spinpipe.schemas.poses import Calibration
from spinpipe.schemas.records import Detection
from spinpipe.stages.geometry.frames import inverse, quaternion_matrix, transform

PATH = "candidate/photo"
PICTURED = 100
"""Candidates and cameras with pictures, at most: reading a photo takes a tenth of a second."""
CAMERA_PX, CANDIDATE_PX = 320, 480
"""Longer sides of the pictures kept."""
AROUND = 0.7
"""What is shown beside a candidate, as a share of its size in the photo."""
EDGES = [(k + i, k + (i + 1) % 4) for k in (0, 4) for i in range(4)] + [
    (i, i + 4) for i in range(4)
]
"""Of a box, by its corners as ``Boxes.corners`` has them."""


@dataclass(frozen=True, eq=False)
class Photo:
    """One photo: where it was taken from and how it maps directions to pixels."""

    name: str
    file: Path | None
    """``None`` where it is not there."""
    position: F64
    """(3,) local."""
    R_local_camera: F64
    """(3, 3): x right, y down, z ahead."""
    lens: Calibration

    def project(self, local: F64) -> F64:
        """Pixels and depths (N, 3) of points (N, 3) in the local frame.

        With the distortion of OpenCV's models ``plumb_bob`` and ``rational_polynomial``
        [docs.opencv.org, camera calibration]; other lenses as if they had none.
        """
        ahead = (local - self.position) @ self.R_local_camera
        depth = ahead[:, 2]
        x, y = (ahead[:, :2] / np.where(abs(depth) > 1e-9, depth, 1e-9)[:, None]).T
        if self.lens.distortion_model in ("plumb_bob", "rational_polynomial"):
            x, y = _distorted(x, y, np.resize(np.append(self.lens.D, np.zeros(8)), 8))
        K = self.lens.K
        u, v = K[0, 0] * x + K[0, 1] * y + K[0, 2], K[1, 1] * y + K[1, 2]
        return np.column_stack([u, v, depth])


def _distorted(x: F64, y: F64, D: F64) -> tuple[F64, F64]:
    k1, k2, p1, p2, k3, k4, k5, k6 = D
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    radial = radial / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def photos_of(read: Reader) -> list[Photo]:
    """All photos whose lens is known."""
    folder = read(SCENE)[0].photos
    lenses = {lens.camera: lens for lens in read(CALIBRATIONS) if lens.K.any()}
    found: list[Photo] = []
    for cameras in read(CAMERAS):
        turns = quaternion_matrix(cameras.quaternions_xyzw)
        for name, place, turn in zip(cameras.names, cameras.positions, turns, strict=True):
            if name in lenses:
                file = Path(folder, name) if folder else None
                there = file if file is not None and file.is_file() else None
                found.append(Photo(name, there, place, turn, lenses[name]))
    return found


def draw_cameras(rec: rr.RecordingStream, photos: Sequence[Photo], size_m: float) -> None:
    """Log each photo as a pinhole camera whose image plane is ``size_m`` away, with its picture."""
    pictured = [photo for photo in photos if photo.file is not None]
    step = max(1, -(-len(pictured) // PICTURED))
    shown = {photo.name for photo in pictured[::step]}
    for i, photo in enumerate(photos):
        path = f"ingest/cameras/{rr.escape_entity_path_part(photo.name)}"
        camera, plane = f"camera {i}", f"photo {i}"
        picture = _picture(photo, CAMERA_PX) if photo.name in shown else None
        width, height = picture.size if picture else (photo.lens.width, photo.lens.height)
        K = np.diag([width / photo.lens.width, height / photo.lens.height, 1.0]) @ photo.lens.K
        rec.log(
            path,
            rr.CoordinateFrame(plane),
            rr.Pinhole(
                image_from_camera=K,
                resolution=(width, height),
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=size_m,
                child_frame=plane,
                parent_frame=camera,
                color=palette.MARK,
            ),
            *([] if picture is None else [_encoded(picture)]),
            static=True,
        )
        rec.log(
            f"frames/{rr.escape_entity_path_part(camera)}",
            rr.Transform3D(
                translation=photo.position,
                mat3x3=photo.R_local_camera,
                child_frame=camera,
                parent_frame=LOCAL,
            ),
            static=True,
        )


def draw_candidate_photos(
    read: Reader, rec: rr.RecordingStream, ranked: Sequence[Detection]
) -> None:
    """Log the photo that shows each of the best candidates largest, with its box projected."""
    photos = [photo for photo in photos_of(read) if photo.file is not None]
    if not photos:
        return
    clear_stale(rec, PATH, ranked, {d.id for d in ranked[:PICTURED]})
    T_local_world = inverse(read(UPRIGHT)[0].T_world_local)
    chosen: dict[int, list[tuple[Detection, F64]]] = defaultdict(list)
    for d, world in zip(ranked[:PICTURED], boxes_of(ranked[:PICTURED]).corners, strict=True):
        corners = transform(T_local_world, world)
        best = _best(photos, corners)
        if best is None:
            at_candidate(rec, d.id)
            rec.log(PATH, rr.Clear(recursive=True))
        else:
            chosen[best].append((d, photos[best].project(corners)[:, :2]))
    for number, shown in chosen.items():
        whole = _picture(photos[number])
        for d, corners in shown if whole is not None else ():
            at_candidate(rec, d.id)
            assert whole is not None
            _draw_candidate(rec, d, whole, corners, photos[number].name)


def _best(photos: Sequence[Photo], corners: F64) -> int | None:
    """The photo that has all corners (8, 3, local) in it and shows them largest."""
    largest, best = 0.0, None
    for i, photo in enumerate(photos):
        u, v, depth = photo.project(corners).T
        size = (photo.lens.width, photo.lens.height)
        if depth.min() <= 0 or min(u.min(), v.min()) < 0 or u.max() > size[0] or v.max() > size[1]:
            continue
        area = float(np.ptp(u) * np.ptp(v)) / (size[0] * size[1])
        if area > largest:
            largest, best = area, i
    return best


def _draw_candidate(
    rec: rr.RecordingStream, d: Detection, whole: Image.Image, corners: F64, name: str
) -> None:
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = AROUND * float((high - low).max())
    left, top = np.floor(np.maximum(low - margin, 0))
    right, bottom = np.ceil(np.minimum(high + margin, whole.size))
    cut = whole.crop((left, top, right, bottom))
    cut.thumbnail((CANDIDATE_PX, CANDIDATE_PX))
    scale = cut.width / (right - left)
    places = (corners - (left, top)) * scale
    rec.log(f"{PATH}/image", _encoded(cut))
    colour = palette.fate_colour(d.fate)[:3]
    rec.log(
        f"{PATH}/box",
        rr.LineStrips2D(
            [places[list(edge)] for edge in EDGES],
            colors=colour,
            # its front is drawn thicker: edges between corners 0, 3, 4 and 7
            radii=[-2.2 if set(edge) <= {0, 3, 4, 7} else -1.0 for edge in EDGES],
        ),
    )
    caption = rr.Points2D([[cut.width / 2, 0]], labels=name, radii=0, colors=colour)
    rec.log(f"{PATH}/name", caption)


def _picture(photo: Photo, longest_px: int | None = None) -> Image.Image | None:
    """The photo as the lens describes it, or smaller; ``None`` if it cannot be read."""
    assert photo.file is not None
    try:
        with Image.open(photo.file) as image:
            if longest_px is not None:
                image.draft("RGB", (longest_px, longest_px))
            picture = image.convert("RGB")
    except OSError:
        return None
    if longest_px is not None:
        picture.thumbnail((longest_px, longest_px))
    elif picture.size != (photo.lens.width, photo.lens.height):  # reconstructed from smaller ones
        picture = picture.resize((photo.lens.width, photo.lens.height))
    return picture


def _encoded(picture: Image.Image) -> rr.EncodedImage:
    buffer = BytesIO()
    picture.save(buffer, format="JPEG", quality=80)
    return rr.EncodedImage(contents=buffer.getvalue(), media_type="image/jpeg")
