"""The data flow of spinpipe: its stages in order."""

from spinpipe.stages.cluster.cluster import Clustering
from spinpipe.stages.ground.ground import Ground
from spinpipe.stages.ingest.ingest import Ingest
from spinpipe.stages.ingest.model import Model
from spinpipe.stages.scan.scan import Scan
from spinpipe.stages.stage import Stage
from spinpipe.stages.verify.verify import Verify

STAGES: tuple[Stage, ...] = (Ingest(), Model(), Ground(), Scan(), Clustering(), Verify())
