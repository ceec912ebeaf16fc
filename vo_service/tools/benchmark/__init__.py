"""Methods on recordings, compared with one another and with other libraries."""
