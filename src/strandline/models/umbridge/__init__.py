"""UM-Bridge, a protocol for models over HTTP: remote simulators as forward models, and studies served to others."""
