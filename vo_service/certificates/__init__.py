"""Keys and certificates for a test network, made with the `openssl` command."""
