"""What the photos say of the light."""
