"""From the tracker to the robot: coordinate chain, tool calibration, trajectories, stereo re-localization."""
