"""Measured and exact coefficients of bodies in water, for tests and for the pictures of the page.

Tables are pairs of Reynolds number and coefficient, unless a comment says otherwise.
"""

# Standard curve of a sphere (Clift, Grace and Weber 1978).
SPHERE = (
    (1, 27.2), (3, 10.5), (10, 4.26), (30, 2.12), (100, 1.09), (300, 0.65), (1e3, 0.47),
    (3e3, 0.40), (1e4, 0.41), (3e4, 0.46), (1e5, 0.50),
)  # fmt: skip

# Long circular cylinder across the flow (Wieselsberger 1922).
CYLINDER = (
    (0.73, 13.2), (3.2, 4.87), (8, 2.94), (18, 2.12), (32, 1.73), (64, 1.48), (196, 1.27),
    (356, 1.15), (892, 0.96), (2270, 0.89), (5150, 0.94), (9180, 1.06), (1.5e4, 1.14), (3e4, 1.16),
    (1.1e5, 1.17),
)  # fmt: skip

# Cylinders of a length over diameter, not of a Reynolds number. Along the flow, flat ends
# (Kritzinger 2004, and a data book), and across the flow with free ends (Wieselsberger 1922).
CYLINDER_ALONG = (
    (0.2, 1.16),
    (0.6, 1.07),
    (0.9, 0.97),
    (1, 0.92),
    (1.5, 0.83),
    (2, 0.83),
    (4, 0.84),
)
SHORT_CYLINDER = ((1, 0.62), (2, 0.69), (5, 0.74), (10, 0.82), (20, 0.92), (42, 0.985))

# Square plate across the flow (Hoerner, secondary source).
PLATE = ((1, 23.0), (10, 3.6), (100, 1.5), (1e3, 1.45), (1e4, 1.17))

# Mean friction of one side of a plate along the flow: Blasius, and Prandtl with a transition at
# 5e5.
FRICTION = ((1e4, 0.0133), (1e5, 0.0042), (1e6, 0.0028), (1e7, 0.0028))

# Aspect ratio, Reynolds number, and pairs of angle (degrees) and lift coefficient. Pelletier and
# Mueller (2000), read from their diagrams, for aspect ratios 1 and 2 at Re 1.4e5. Tow tank of
# Dickson, in Taira et al. (2007), for aspect ratio 2 at Re 100.
LIFT = (
    (1.0, 1.4e5, ((10, 0.25), (15, 0.50), (20, 0.70), (25, 0.80), (28, 0.80))),
    (2.0, 1.4e5, ((10, 0.50), (15, 0.70), (20, 0.75), (25, 0.67))),
    (
        2.0, 100.0,
        ((5, 0.20), (10, 0.38), (20, 0.68), (30, 0.76), (45, 0.73), (60, 0.59), (75, 0.40)),
    ),
)  # fmt: skip
