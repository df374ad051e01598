"""Range scans: simulated measurement, and obstacles found in them."""
