"""A mission onto real robots: certificates, access control, bundles, and putting them there."""
