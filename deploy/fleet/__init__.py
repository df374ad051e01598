"""Deploy a mission to real robots: certificates, access control, bundles, and pushing them."""
