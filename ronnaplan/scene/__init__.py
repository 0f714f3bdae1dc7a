"""What there is to see of a head in 3-D: bodies, the eye that sees them, and the picture of them."""
