"""Forward kinematics of planar and URDF arms, with kinematic errors."""
