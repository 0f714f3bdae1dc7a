"""The DICOM node: receives scans, finds their markers and sends the answers back, and loses nothing between."""
