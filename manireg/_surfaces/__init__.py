"""Registration of scanned surfaces."""
