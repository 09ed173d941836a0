"""The paper's world, N at a time, and vehicles that are not there; no torch, no wire."""
