"""The documents of one patient together, judged once: every face of the program asks this room."""
