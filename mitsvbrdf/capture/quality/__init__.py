"""How good the photos are."""
