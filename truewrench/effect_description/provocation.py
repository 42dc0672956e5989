"""How each effect of the catalogue shows itself in a residual, and which motion makes it large: for the manual."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Provocation:
    """Two sentences on an effect.

    shows    what of it is seen in the residual of the rigid tool
    motion   which motion or test makes it large, or separates it from what resembles it
    """

    shows: str
    motion: str


PROVOCATIONS: dict[str, Provocation] = {
    "com_offset": Provocation(
        "A torque in proportion to gravity's component along the tip, at rest as in motion, and nothing in the forces "
        "as long as the motion is slow.",
        "Static poses all around the circle: the torque is a sine of the angle, and its phase is off by the direction "
        "of the offset. Fast rotation adds a force that separates it from crosstalk.",
    ),
    "gravity_tilt": Provocation(
        "Sine and cosine of the orientation in the force channels, independent of speed.",
        "Many orientations at one position, held still: a tether changes with position, a tilted gravity does not.",
    ),
    "joint_offset": Provocation(
        "A small turn of the whole weight and of the acceleration, constant over time and different for each joint.",
        "Move one joint at a time, with the others in several poses; fast motion separates the joints, "
        "because each offset turns another acceleration.",
    ),
    "joint_elasticity": Provocation(
        "Like a joint offset that follows the load: largest where the arm is stretched out horizontally.",
        "The same poses with and without a known extra weight: the difference grows with the weight, that of an offset "
        "does not.",
    ),
    "joint_backlash": Provocation(
        "A step where the torque of the weight about the joint changes its sign, constant on either side.",
        "Swing each joint slowly through the pose in which its load changes sign, from both sides.",
    ),
    "link_length_error": Provocation(
        "In proportion to the acceleration of the link's end: nothing at rest, quadratic in the speed of the motion.",
        "Fast rotation of the joint before the link, with the joints behind it held in different poses.",
    ),
    "sensor_rotation": Provocation(
        "Each force channel has a part of the other's load, with opposite signs.",
        "Static poses turned about the tool axis: crosstalk of one channel does not keep the length of the force.",
    ),
    "viscous_drag": Provocation(
        "A force against the velocity, in proportion to it, with a torque by its distance from the sensor.",
        "The same path at half, normal and double speed: the residual doubles with the speed.",
    ),
    "quadratic_drag": Provocation(
        "A force against the velocity that is nearly zero in slow parts and large in fast ones.",
        "The same path at half, normal and double speed: the residual grows fourfold when the speed doubles.",
    ),
    "coulomb_friction": Provocation(
        "A step in the torque wherever the rotation reverses, of the same height at any speed.",
        "Reverse slowly and fast in the same pose: a viscous torque changes with the speed, this one does not.",
    ),
    "cable_spring": Provocation(
        "A force that depends on the position alone, zero where the cable is slack.",
        "Approach the place where it goes taut from several sides, at one orientation and slowly.",
    ),
    "tip_flexibility": Provocation(
        "In proportion to the second derivative of the wrench: grows with the square of the frequency, and rings after "
        "a knock.",
        "A motion with frequencies as high as the robot allows, or a knock on the tool while it is recorded.",
    ),
    "payload_change": Provocation(
        "The residual of the later repeats is that of another weight: a step between repeats, not within the mean of "
        "them.",
        "Nothing to provoke: look at what the gripper did at the time found, and record before and after separately.",
    ),
    "contact_event": Provocation(
        "A pulse in one repeat that the others do not have.",
        "Nothing to provoke: look at what touched the tool at the time found.",
    ),
    "sensor_gain": Provocation(
        "The residual of a channel has the shape of its own load, fast and slow parts alike.",
        "Known weights along each axis; in motion, loads that are large in every channel compared with one another.",
    ),
    "sensor_crosstalk": Provocation(
        "One channel's residual has the shape of another channel's load, at any frequency.",
        "Poses or motions in which one channel is loaded and the others are not.",
    ),
    "gain_nonlinearity": Provocation(
        "Harmonics of a channel's own load; the residual against the load is a parabola or a cubic.",
        "The same motion at several amplitudes, and with several known weights, up to the largest load.",
    ),
    "sensor_hysteresis": Provocation(
        "A loop against the channel's own load, which does not widen with the speed.",
        "Load and unload slowly, in large loops and in small ones within them.",
    ),
    "sensor_lag": Provocation(
        "In proportion to the rate of the load, with a phase that grows with frequency and an amplitude that falls.",
        "Fast motion: at low frequencies a lag is a delay; the amplitude at high ones separates them.",
    ),
    "time_delay": Provocation(
        "In proportion to the rate of the load, with a phase that grows with the frequency and an unchanged amplitude.",
        "Fast motion, and one sharp event that both the robot and the sensor record.",
    ),
    "saturation": Provocation(
        "Zero up to a level, then one-sided: the peaks of the reading are flat.",
        "Larger loads: more of the peaks is cut. Smaller ones: it disappears.",
    ),
    "bias_drift": Provocation(
        "Slow, different in each repeat and in each channel, whatever the motion does.",
        "Hold one pose for as long as the recording lasts, before and after it.",
    ),
    "thermal_drift": Provocation(
        "Slow, in proportion to the logged temperature, whatever the motion does.",
        "Record the warm-up from a cold start with the temperature logged, and a second time when warm.",
    ),
    "line_interference": Provocation(
        "One line in the spectrum that lies between the multiples of the motion's frequency.",
        "Another period of the motion, or another sampling rate: an alias moves, a resonance of the tool does not.",
    ),
}
"""By the id of the effect."""
