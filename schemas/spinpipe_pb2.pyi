from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Array(_message.Message):
    __slots__ = ("dtype", "shape", "data")
    DTYPE_FIELD_NUMBER: _ClassVar[int]
    SHAPE_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    dtype: str
    shape: _containers.RepeatedScalarFieldContainer[int]
    data: bytes
    def __init__(self, dtype: _Optional[str] = ..., shape: _Optional[_Iterable[int]] = ..., data: _Optional[bytes] = ...) -> None: ...

class SceneFrame(_message.Message):
    __slots__ = ("origin", "scale", "points", "dropped", "coloured", "source", "strays", "duplicates", "kind", "crs", "up", "up_reason", "spacing_m", "step_m", "photos", "fields", "unit_source")
    ORIGIN_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    DROPPED_FIELD_NUMBER: _ClassVar[int]
    COLOURED_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    STRAYS_FIELD_NUMBER: _ClassVar[int]
    DUPLICATES_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    CRS_FIELD_NUMBER: _ClassVar[int]
    UP_FIELD_NUMBER: _ClassVar[int]
    UP_REASON_FIELD_NUMBER: _ClassVar[int]
    SPACING_M_FIELD_NUMBER: _ClassVar[int]
    STEP_M_FIELD_NUMBER: _ClassVar[int]
    PHOTOS_FIELD_NUMBER: _ClassVar[int]
    FIELDS_FIELD_NUMBER: _ClassVar[int]
    UNIT_SOURCE_FIELD_NUMBER: _ClassVar[int]
    origin: _containers.RepeatedScalarFieldContainer[float]
    scale: _containers.RepeatedScalarFieldContainer[float]
    points: int
    dropped: int
    coloured: bool
    source: str
    strays: int
    duplicates: int
    kind: str
    crs: str
    up: _containers.RepeatedScalarFieldContainer[float]
    up_reason: str
    spacing_m: float
    step_m: float
    photos: str
    fields: _containers.RepeatedScalarFieldContainer[str]
    unit_source: str
    def __init__(self, origin: _Optional[_Iterable[float]] = ..., scale: _Optional[_Iterable[float]] = ..., points: _Optional[int] = ..., dropped: _Optional[int] = ..., coloured: bool = ..., source: _Optional[str] = ..., strays: _Optional[int] = ..., duplicates: _Optional[int] = ..., kind: _Optional[str] = ..., crs: _Optional[str] = ..., up: _Optional[_Iterable[float]] = ..., up_reason: _Optional[str] = ..., spacing_m: _Optional[float] = ..., step_m: _Optional[float] = ..., photos: _Optional[str] = ..., fields: _Optional[_Iterable[str]] = ..., unit_source: _Optional[str] = ...) -> None: ...

class TileIndex(_message.Message):
    __slots__ = ("low", "high", "counts")
    LOW_FIELD_NUMBER: _ClassVar[int]
    HIGH_FIELD_NUMBER: _ClassVar[int]
    COUNTS_FIELD_NUMBER: _ClassVar[int]
    low: Array
    high: Array
    counts: Array
    def __init__(self, low: _Optional[_Union[Array, _Mapping]] = ..., high: _Optional[_Union[Array, _Mapping]] = ..., counts: _Optional[_Union[Array, _Mapping]] = ...) -> None: ...

class ObjectModel(_message.Message):
    __slots__ = ("name", "points", "normals", "vertices", "faces", "T_object_model", "visible_from", "stretch")
    NAME_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    NORMALS_FIELD_NUMBER: _ClassVar[int]
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    FACES_FIELD_NUMBER: _ClassVar[int]
    T_OBJECT_MODEL_FIELD_NUMBER: _ClassVar[int]
    VISIBLE_FROM_FIELD_NUMBER: _ClassVar[int]
    STRETCH_FIELD_NUMBER: _ClassVar[int]
    name: str
    points: Array
    normals: Array
    vertices: Array
    faces: Array
    T_object_model: Array
    visible_from: str
    stretch: float
    def __init__(self, name: _Optional[str] = ..., points: _Optional[_Union[Array, _Mapping]] = ..., normals: _Optional[_Union[Array, _Mapping]] = ..., vertices: _Optional[_Union[Array, _Mapping]] = ..., faces: _Optional[_Union[Array, _Mapping]] = ..., T_object_model: _Optional[_Union[Array, _Mapping]] = ..., visible_from: _Optional[str] = ..., stretch: _Optional[float] = ...) -> None: ...

class Plane(_message.Message):
    __slots__ = ("normal", "offset", "inliers", "points", "rms_m", "inlier_distance_m", "up_source", "evidence", "levels")
    NORMAL_FIELD_NUMBER: _ClassVar[int]
    OFFSET_FIELD_NUMBER: _ClassVar[int]
    INLIERS_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    RMS_M_FIELD_NUMBER: _ClassVar[int]
    INLIER_DISTANCE_M_FIELD_NUMBER: _ClassVar[int]
    UP_SOURCE_FIELD_NUMBER: _ClassVar[int]
    EVIDENCE_FIELD_NUMBER: _ClassVar[int]
    LEVELS_FIELD_NUMBER: _ClassVar[int]
    normal: _containers.RepeatedScalarFieldContainer[float]
    offset: float
    inliers: int
    points: int
    rms_m: float
    inlier_distance_m: float
    up_source: str
    evidence: _containers.RepeatedCompositeFieldContainer[Evidence]
    levels: _containers.RepeatedCompositeFieldContainer[Level]
    def __init__(self, normal: _Optional[_Iterable[float]] = ..., offset: _Optional[float] = ..., inliers: _Optional[int] = ..., points: _Optional[int] = ..., rms_m: _Optional[float] = ..., inlier_distance_m: _Optional[float] = ..., up_source: _Optional[str] = ..., evidence: _Optional[_Iterable[_Union[Evidence, _Mapping]]] = ..., levels: _Optional[_Iterable[_Union[Level, _Mapping]]] = ...) -> None: ...

class Level(_message.Message):
    __slots__ = ("height_m", "share")
    HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    SHARE_FIELD_NUMBER: _ClassVar[int]
    height_m: float
    share: float
    def __init__(self, height_m: _Optional[float] = ..., share: _Optional[float] = ...) -> None: ...

class Sampling(_message.Message):
    __slots__ = ("spacing_m", "noise_m", "errors", "blur_m")
    SPACING_M_FIELD_NUMBER: _ClassVar[int]
    NOISE_M_FIELD_NUMBER: _ClassVar[int]
    ERRORS_FIELD_NUMBER: _ClassVar[int]
    BLUR_M_FIELD_NUMBER: _ClassVar[int]
    spacing_m: float
    noise_m: float
    errors: _containers.RepeatedCompositeFieldContainer[ErrorOver]
    blur_m: float
    def __init__(self, spacing_m: _Optional[float] = ..., noise_m: _Optional[float] = ..., errors: _Optional[_Iterable[_Union[ErrorOver, _Mapping]]] = ..., blur_m: _Optional[float] = ...) -> None: ...

class ErrorOver(_message.Message):
    __slots__ = ("side_m", "error_m")
    SIDE_M_FIELD_NUMBER: _ClassVar[int]
    ERROR_M_FIELD_NUMBER: _ClassVar[int]
    side_m: float
    error_m: float
    def __init__(self, side_m: _Optional[float] = ..., error_m: _Optional[float] = ...) -> None: ...

class Evidence(_message.Message):
    __slots__ = ("name", "value")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    name: str
    value: float
    def __init__(self, name: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...

class SpinImage(_message.Message):
    __slots__ = ("model", "role", "radius_m", "height_m", "bin_m", "values", "origin", "correlation")
    MODEL_FIELD_NUMBER: _ClassVar[int]
    ROLE_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    BIN_M_FIELD_NUMBER: _ClassVar[int]
    VALUES_FIELD_NUMBER: _ClassVar[int]
    ORIGIN_FIELD_NUMBER: _ClassVar[int]
    CORRELATION_FIELD_NUMBER: _ClassVar[int]
    model: str
    role: str
    radius_m: float
    height_m: float
    bin_m: float
    values: Array
    origin: _containers.RepeatedScalarFieldContainer[float]
    correlation: float
    def __init__(self, model: _Optional[str] = ..., role: _Optional[str] = ..., radius_m: _Optional[float] = ..., height_m: _Optional[float] = ..., bin_m: _Optional[float] = ..., values: _Optional[_Union[Array, _Mapping]] = ..., origin: _Optional[_Iterable[float]] = ..., correlation: _Optional[float] = ...) -> None: ...

class Hits(_message.Message):
    __slots__ = ("model", "points", "correlation")
    MODEL_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    CORRELATION_FIELD_NUMBER: _ClassVar[int]
    model: str
    points: Array
    correlation: Array
    def __init__(self, model: _Optional[str] = ..., points: _Optional[_Union[Array, _Mapping]] = ..., correlation: _Optional[_Union[Array, _Mapping]] = ...) -> None: ...

class Cluster(_message.Message):
    __slots__ = ("id", "model", "position", "hits", "correlation", "method")
    ID_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    HITS_FIELD_NUMBER: _ClassVar[int]
    CORRELATION_FIELD_NUMBER: _ClassVar[int]
    METHOD_FIELD_NUMBER: _ClassVar[int]
    id: int
    model: str
    position: _containers.RepeatedScalarFieldContainer[float]
    hits: int
    correlation: float
    method: str
    def __init__(self, id: _Optional[int] = ..., model: _Optional[str] = ..., position: _Optional[_Iterable[float]] = ..., hits: _Optional[int] = ..., correlation: _Optional[float] = ..., method: _Optional[str] = ...) -> None: ...

class BlockHypotheses(_message.Message):
    __slots__ = ("look", "candidate", "model", "start", "pose", "lean", "parts", "evidence", "odds", "course_candidate", "course_length", "course_poses", "course_rms_m")
    LOOK_FIELD_NUMBER: _ClassVar[int]
    CANDIDATE_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    START_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    LEAN_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    EVIDENCE_FIELD_NUMBER: _ClassVar[int]
    ODDS_FIELD_NUMBER: _ClassVar[int]
    COURSE_CANDIDATE_FIELD_NUMBER: _ClassVar[int]
    COURSE_LENGTH_FIELD_NUMBER: _ClassVar[int]
    COURSE_POSES_FIELD_NUMBER: _ClassVar[int]
    COURSE_RMS_M_FIELD_NUMBER: _ClassVar[int]
    look: int
    candidate: Array
    model: Array
    start: Array
    pose: Array
    lean: Array
    parts: Array
    evidence: Array
    odds: Array
    course_candidate: Array
    course_length: Array
    course_poses: Array
    course_rms_m: Array
    def __init__(self, look: _Optional[int] = ..., candidate: _Optional[_Union[Array, _Mapping]] = ..., model: _Optional[_Union[Array, _Mapping]] = ..., start: _Optional[_Union[Array, _Mapping]] = ..., pose: _Optional[_Union[Array, _Mapping]] = ..., lean: _Optional[_Union[Array, _Mapping]] = ..., parts: _Optional[_Union[Array, _Mapping]] = ..., evidence: _Optional[_Union[Array, _Mapping]] = ..., odds: _Optional[_Union[Array, _Mapping]] = ..., course_candidate: _Optional[_Union[Array, _Mapping]] = ..., course_length: _Optional[_Union[Array, _Mapping]] = ..., course_poses: _Optional[_Union[Array, _Mapping]] = ..., course_rms_m: _Optional[_Union[Array, _Mapping]] = ...) -> None: ...

class FitTrace(_message.Message):
    __slots__ = ("cluster", "start_heading_deg", "rms_m", "poses")
    CLUSTER_FIELD_NUMBER: _ClassVar[int]
    START_HEADING_DEG_FIELD_NUMBER: _ClassVar[int]
    RMS_M_FIELD_NUMBER: _ClassVar[int]
    POSES_FIELD_NUMBER: _ClassVar[int]
    cluster: int
    start_heading_deg: Array
    rms_m: Array
    poses: Array
    def __init__(self, cluster: _Optional[int] = ..., start_heading_deg: _Optional[_Union[Array, _Mapping]] = ..., rms_m: _Optional[_Union[Array, _Mapping]] = ..., poses: _Optional[_Union[Array, _Mapping]] = ...) -> None: ...

class Part(_message.Message):
    __slots__ = ("name", "value", "reference", "merit")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_FIELD_NUMBER: _ClassVar[int]
    MERIT_FIELD_NUMBER: _ClassVar[int]
    name: str
    value: float
    reference: float
    merit: float
    def __init__(self, name: _Optional[str] = ..., value: _Optional[float] = ..., reference: _Optional[float] = ..., merit: _Optional[float] = ...) -> None: ...

class Detection(_message.Message):
    __slots__ = ("id", "model", "fate", "reason", "T_world_object", "T_scene_model", "position_world", "position_scene", "heading_deg", "heading_margin", "correlation", "rms_m", "inlier_weight", "runner_up_heading_deg", "runner_up_rms_m", "coverage_model", "coverage_scene", "observed", "score", "parts", "size_m", "alternative", "alternative_margin", "cause", "duplicate_of", "log_odds", "tilt_deg", "gate_m", "sharp_m", "min_score")
    ID_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    FATE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    T_WORLD_OBJECT_FIELD_NUMBER: _ClassVar[int]
    T_SCENE_MODEL_FIELD_NUMBER: _ClassVar[int]
    POSITION_WORLD_FIELD_NUMBER: _ClassVar[int]
    POSITION_SCENE_FIELD_NUMBER: _ClassVar[int]
    HEADING_DEG_FIELD_NUMBER: _ClassVar[int]
    HEADING_MARGIN_FIELD_NUMBER: _ClassVar[int]
    CORRELATION_FIELD_NUMBER: _ClassVar[int]
    RMS_M_FIELD_NUMBER: _ClassVar[int]
    INLIER_WEIGHT_FIELD_NUMBER: _ClassVar[int]
    RUNNER_UP_HEADING_DEG_FIELD_NUMBER: _ClassVar[int]
    RUNNER_UP_RMS_M_FIELD_NUMBER: _ClassVar[int]
    COVERAGE_MODEL_FIELD_NUMBER: _ClassVar[int]
    COVERAGE_SCENE_FIELD_NUMBER: _ClassVar[int]
    OBSERVED_FIELD_NUMBER: _ClassVar[int]
    SCORE_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    SIZE_M_FIELD_NUMBER: _ClassVar[int]
    ALTERNATIVE_FIELD_NUMBER: _ClassVar[int]
    ALTERNATIVE_MARGIN_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    DUPLICATE_OF_FIELD_NUMBER: _ClassVar[int]
    LOG_ODDS_FIELD_NUMBER: _ClassVar[int]
    TILT_DEG_FIELD_NUMBER: _ClassVar[int]
    GATE_M_FIELD_NUMBER: _ClassVar[int]
    SHARP_M_FIELD_NUMBER: _ClassVar[int]
    MIN_SCORE_FIELD_NUMBER: _ClassVar[int]
    id: int
    model: str
    fate: str
    reason: str
    T_world_object: Array
    T_scene_model: Array
    position_world: _containers.RepeatedScalarFieldContainer[float]
    position_scene: _containers.RepeatedScalarFieldContainer[float]
    heading_deg: float
    heading_margin: float
    correlation: float
    rms_m: float
    inlier_weight: float
    runner_up_heading_deg: float
    runner_up_rms_m: float
    coverage_model: float
    coverage_scene: float
    observed: float
    score: float
    parts: _containers.RepeatedCompositeFieldContainer[Part]
    size_m: _containers.RepeatedScalarFieldContainer[float]
    alternative: str
    alternative_margin: float
    cause: str
    duplicate_of: int
    log_odds: float
    tilt_deg: float
    gate_m: float
    sharp_m: float
    min_score: float
    def __init__(self, id: _Optional[int] = ..., model: _Optional[str] = ..., fate: _Optional[str] = ..., reason: _Optional[str] = ..., T_world_object: _Optional[_Union[Array, _Mapping]] = ..., T_scene_model: _Optional[_Union[Array, _Mapping]] = ..., position_world: _Optional[_Iterable[float]] = ..., position_scene: _Optional[_Iterable[float]] = ..., heading_deg: _Optional[float] = ..., heading_margin: _Optional[float] = ..., correlation: _Optional[float] = ..., rms_m: _Optional[float] = ..., inlier_weight: _Optional[float] = ..., runner_up_heading_deg: _Optional[float] = ..., runner_up_rms_m: _Optional[float] = ..., coverage_model: _Optional[float] = ..., coverage_scene: _Optional[float] = ..., observed: _Optional[float] = ..., score: _Optional[float] = ..., parts: _Optional[_Iterable[_Union[Part, _Mapping]]] = ..., size_m: _Optional[_Iterable[float]] = ..., alternative: _Optional[str] = ..., alternative_margin: _Optional[float] = ..., cause: _Optional[str] = ..., duplicate_of: _Optional[int] = ..., log_odds: _Optional[float] = ..., tilt_deg: _Optional[float] = ..., gate_m: _Optional[float] = ..., sharp_m: _Optional[float] = ..., min_score: _Optional[float] = ...) -> None: ...
