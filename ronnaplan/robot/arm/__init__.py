"""Serial arms: their description, forward and inverse kinematics, margins, and what errors do to the tool."""
