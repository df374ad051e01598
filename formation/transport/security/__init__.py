"""Certificates and signed orders."""
