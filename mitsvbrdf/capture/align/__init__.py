"""From photos to a rig: the lens, and the pose of the camera in each photo.

With a printed sheet: ``sheet`` has the positions of its tags, ``tag_edges`` measures the tags in each photo,
``from_sheet`` fits lens and poses to all measurements. Without a sheet, ``from_photos`` calls these in turn:
``features`` matches features of photos and chains homographies, ``planar`` finds lens and poses by bundle
adjustment, ``patch`` chooses the square that all photos show.
"""
