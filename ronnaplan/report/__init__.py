"""Results for people: tables, pictures and the printable quality report."""
