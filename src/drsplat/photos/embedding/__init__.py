"""Features of photos on disk: the photos, masks and crops that are embedded; resumable."""
