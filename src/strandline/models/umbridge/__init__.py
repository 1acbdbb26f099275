"""UM-Bridge, a protocol for models over HTTP: remote simulators as forward models, and studies served to others."""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.models.umbridge.answers import Blocks, ServedModel
    from strandline.models.umbridge.model import flattened
    from strandline.models.umbridge.server import Access, UMBridgeServer, is_loopback
else:
    __getattr__ = door(__name__, __file__)
