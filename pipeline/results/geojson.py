"""Detections as GeoJSON: footprints in longitude and latitude [RFC 7946].

Written only where the scene says in which coordinate reference system it is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from spinpipe.pipeline.results.instances import T_scene_object, box_corners, plain, row
from spinpipe.schemas.records import Detection, ObjectModel
from spinpipe.stages.stage import StageError


def geojson(detections: Sequence[Detection], models: Mapping[str, ObjectModel], crs: str) -> str:
    """A FeatureCollection: one polygon a detection, its row as properties.

    Parameters
    ----------
    detections : to write.
    models : of the run, by name.
    crs : of the scene's x and y, as PROJ understands it: ``EPSG:32615`` or WKT.

    Raises
    ------
    StageError
        If PROJ does not know the reference system.
    """
    from pyproj import CRS, Transformer
    from pyproj.exceptions import CRSError

    if not crs:
        raise StageError(
            "the scene names no coordinate reference system, which GeoJSON needs: "
            "use another format"
        )
    try:
        system = CRS.from_user_input(crs)
    except CRSError as error:
        raise StageError(f"the scene's reference system is not understood: {error}") from None
    to_degrees = Transformer.from_crs(system, "EPSG:4326", always_xy=True)
    features = []
    for d in detections:
        base = box_corners(d, T_scene_object(d, models))[[0, 1, 2, 3, 0]]
        longitude, latitude = to_degrees.transform(base[:, 0], base[:, 1])
        ring = [[round(x, 9), round(y, 9)] for x, y in zip(longitude, latitude, strict=True)]
        features.append(
            {
                "type": "Feature",
                "id": d.id,
                "geometry": {"type": "Polygon", "coordinates": [ring]},
                "properties": plain(row(d, models)),
            }
        )
    document = {"type": "FeatureCollection", "features": features}
    return json.dumps(document, indent=1, allow_nan=False) + "\n"
