"""The monitor, which watches and never drives: metrics, recording, exporters."""
