"""The process that watches and never drives: metrics, recording, figures."""
