"""What a scanner makes of a ball: its slices, where its scale ends, and what is made good of that."""
