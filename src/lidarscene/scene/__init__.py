"""What light can meet: bodies, sun, sky, air and weather, and the files that describe them."""
