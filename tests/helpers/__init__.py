"""What tests share: scenes, brute-force references, readers, browsers. No test imports a test."""
