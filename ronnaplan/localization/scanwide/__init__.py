"""What the balls of a scan say together of it, and of each other."""
