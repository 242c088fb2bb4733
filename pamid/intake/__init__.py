"""What happens to a recording before a fit: raw logs in, and checks of what came out."""
