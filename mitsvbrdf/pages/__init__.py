"""Pages and pictures that know no material."""
