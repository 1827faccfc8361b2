"""Creatures: shapes, materials, joints, sensors, and surfaces in contact with water."""
