"""From photos to a rig: the lens, and the pose of the camera in each photo.

With a printed sheet: ``sheet`` says where its tags are, ``tag_edges`` measures them in each photo,
``from_sheet`` explains all measurements at once. Without: ``features`` matches what photos share and chains
their homographies, ``planar`` finds lens and poses by bundle adjustment, ``patch`` chooses the square that
all show; ``from_photos`` calls these in turn.
"""
