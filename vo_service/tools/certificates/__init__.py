"""Keys and certificates for a TLS network."""
