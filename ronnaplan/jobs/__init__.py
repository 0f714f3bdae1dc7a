"""What everything that works on many scans stands on: rules, child processes with limits, a small database."""
