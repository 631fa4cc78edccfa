"""Which reader reads a scene: chosen by what the file holds, whatever it is called."""

from __future__ import annotations

from pathlib import Path

from spinpipe.stages.ingest.readers.colmap import ColmapSource, with_cameras
from spinpipe.stages.ingest.readers.e57 import E57Source
from spinpipe.stages.ingest.readers.file_kind import file_kind
from spinpipe.stages.ingest.readers.las import LasSource
from spinpipe.stages.ingest.readers.mcap import McapSource
from spinpipe.stages.ingest.readers.mesh import MESHES, sampled_mesh
from spinpipe.stages.ingest.readers.pcd import PcdSource
from spinpipe.stages.ingest.readers.ply import PlySource
from spinpipe.stages.ingest.readers.scene_source import SceneSource
from spinpipe.stages.ingest.readers.sfm import read_sfm
from spinpipe.stages.ingest.readers.text import TextSource
from spinpipe.stages.stage import StageError


def open_scene(path: Path, topic: str | None = None) -> SceneSource:
    """Open a cloud, a mesh (it is sampled), a log or the folder of a COLMAP model.

    Parameters
    ----------
    path : file or folder.
    topic : of a log that holds clouds on several.

    Raises
    ------
    StageError
        When the path does not exist, is of no known kind or cannot be read.
    """
    kind = "folder" if path.is_dir() else file_kind(path)
    if topic and kind != "mcap":
        raise StageError(f"{path}: only MCAP files have topics: remove [ingest] topic")
    if kind == "folder":
        return _open_folder(path)
    if kind in MESHES:
        mesh = sampled_mesh(path, kind)
        if mesh is not None:
            return mesh
    match kind:
        case "ply":
            return PlySource(path)
        case "las":
            return LasSource(path)
        case "pcd":
            return PcdSource(path)
        case "e57":
            return E57Source(path)
        case "mcap":
            return McapSource(path, topic)
        case "text":
            return TextSource(path)
        case "obj":
            return TextSource(path, b"v")
        case "colmap":
            return ColmapSource(path)
        case "bundler" | "patch" | "opensfm":
            return read_sfm(path, kind)
        case _:
            raise StageError(
                f"{path}: it has no faces, and points are not read from {kind} files: export the "
                "cloud as PLY, or a mesh with faces"
            )


def _open_folder(folder: Path) -> SceneSource:
    """A COLMAP model, or the dense cloud fused from it where one lies beside it.

    COLMAP writes ``dense/fused.ply`` and undistorts the model into ``dense/sparse``.
    """
    places = [folder, folder / "dense"]
    if folder.name in ("sparse", "0"):
        places += [folder.parent, folder.parent.parent]
    for place in places:
        fused = place / "fused.ply"
        if fused.is_file():
            source = PlySource(fused)
            models = (folder, place / "sparse", place / "sparse" / "0")
            source.about = with_cameras(source.about, *models)
            return source
    return ColmapSource(folder)
