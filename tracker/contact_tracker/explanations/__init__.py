"""What explains motion beside one contact: further contacts, joints and curved surfaces (docs/theory.md,
sections 18 and 20)."""
