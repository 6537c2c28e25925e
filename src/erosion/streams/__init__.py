"""Many particles whose parameters follow laws of probability: means, and their sampling errors."""
