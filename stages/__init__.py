"""The data flow of spinpipe: its stages in order."""

from spinpipe.stages.cluster import Clustering
from spinpipe.stages.ground import Ground
from spinpipe.stages.ingest import Ingest
from spinpipe.stages.scan import Scan
from spinpipe.stages.stage import Stage
from spinpipe.stages.verify import Verify

STAGES: tuple[Stage, ...] = (Ingest(), Ground(), Scan(), Clustering(), Verify())
