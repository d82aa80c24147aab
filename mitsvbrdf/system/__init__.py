"""Files, images, progress and timing: nothing of materials."""
