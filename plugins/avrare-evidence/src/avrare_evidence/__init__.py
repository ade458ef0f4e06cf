"""Safety-case packs: claims, evidence, defeaters, and confirmation by another person."""
