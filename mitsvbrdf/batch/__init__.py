"""Many captures, one library: materials fitted one after the other or many at once, and the folder that holds them all."""
