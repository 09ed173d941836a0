"""What the vehicle knows of its surroundings: frames, geometry, maps. Pure: no clock, no socket."""
