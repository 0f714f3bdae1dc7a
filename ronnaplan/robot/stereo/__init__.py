"""The cameras on the robot: their calibration, a sphere in their images, and markers found again by them."""
