"""What a camera sees of the tags: rendered frames, or detections without pixels."""
