"""Explanations of motion other than one contact: further contacts, joints, curved surfaces (docs/theory.md,
sections 18 and 20)."""
