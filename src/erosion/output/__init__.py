"""What leaves the package: text tables, whole files, two languages."""
