"""Folders of thousands of pictures: one lens a group, all cores or a cluster, resumable."""

from hybrid.batch.groups import GROUPINGS as GROUPINGS
from hybrid.batch.run import Batch as Batch
from hybrid.batch.run import BatchConfig as BatchConfig
