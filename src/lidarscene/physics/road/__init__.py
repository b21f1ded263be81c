"""Roads and vehicles: the roughness of road surfaces, and how a sprung vehicle rides over it."""
