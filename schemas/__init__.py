"""Every topic of a run: which stage writes it, under which name, as which message."""

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame

from spinpipe.schemas import foxglove_codec as foxglove
from spinpipe.schemas import spinpipe_pb2 as pb
from spinpipe.schemas.record_codec import record_topic
from spinpipe.schemas.records import (
    BlockHypotheses,
    Cluster,
    Detection,
    FitTrace,
    Hits,
    ObjectModel,
    Plane,
    Sampling,
    SceneFrame,
    SpinImage,
    TileIndex,
)
from spinpipe.schemas.topics import Topic

CLOUD = Topic("/ingest/cloud", PointCloud, foxglove.encode_tile, foxglove.decode_tile)
TILES = record_topic("/ingest/tiles", TileIndex, pb.TileIndex)
SCENE = record_topic("/ingest/scene", SceneFrame, pb.SceneFrame)
CAMERAS = Topic(
    "/ingest/cameras", FrameTransforms, foxglove.encode_cameras, foxglove.decode_cameras
)
CALIBRATIONS = Topic(
    "/ingest/calibrations",
    CameraCalibration,
    foxglove.encode_calibration,
    foxglove.decode_calibration,
)
TRAJECTORY = Topic(
    "/ingest/trajectory", FrameTransforms, foxglove.encode_trajectory, foxglove.decode_trajectory
)

MODELS = record_topic("/model/objects", ObjectModel, pb.ObjectModel)

PLANE = record_topic("/ground/plane", Plane, pb.Plane)
UPRIGHT = Topic("/ground/upright", FrameTransform, foxglove.encode_upright, foxglove.decode_upright)
SAMPLING = record_topic("/ground/sampling", Sampling, pb.Sampling)

SCORES = Topic("/scan/scores", PointCloud, foxglove.encode_scores, foxglove.decode_scores)
SPIN_IMAGES = record_topic("/scan/spin_images", SpinImage, pb.SpinImage)
HITS = record_topic("/scan/hits", Hits, pb.Hits)

CLUSTERS = record_topic("/cluster/clusters", Cluster, pb.Cluster)

HYPOTHESES = record_topic("/verify/hypotheses", BlockHypotheses, pb.BlockHypotheses)
TRACES = record_topic("/verify/traces", FitTrace, pb.FitTrace)
DETECTIONS = record_topic("/verify/detections", Detection, pb.Detection)
INSTANCES = Topic(
    "/verify/instances", PosesInFrame, foxglove.encode_instances, foxglove.decode_instances
)
