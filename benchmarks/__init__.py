"""Speed and accuracy against peers; each module runs alone and prints a table."""
