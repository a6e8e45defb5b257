"""Registration of scanned surfaces, and the landmarks it goes by."""
