"""What a body is: shapes, materials, joints, sensors, the surface that meets the water."""
