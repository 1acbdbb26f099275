"""UM-Bridge, a protocol for models over HTTP: simulators elsewhere as forward models, and studies served to others."""
