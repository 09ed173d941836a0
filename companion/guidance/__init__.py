"""What to do next: target tracks, the proposed velocity, the shield and the supervisor. Pure."""
