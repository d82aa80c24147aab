"""What fits: a pool of workers on Ray, each with a watched child; what dies is started anew."""
