"""Where the robot shall stand: places from which every trajectory and every marker is served, with margins."""
