# %% [markdown]
# # The chapter, checked
#
# The planar model of this project comes from Bassi, Benzi, Capisani, Cuppone, Ferrara, "Characterization of the
# Dynamical Model of a Force Sensor for Robot Manipulators" (chapter 22). Here its equations 22.2 to 22.10 and 22.13 to
# 22.16 stand, letter by letter as they are printed, next to what the project derives by itself, and SymPy takes the
# difference. Zero means that they agree. Eight errata are shown the same way: by a difference that vanishes, or by one
# that does not.
#
# **The question: are the equations as printed right, and does the project compute with the right ones?**

# %%
import builtins

import numpy as np
import sympy as sp

import truewrench as tw
from truewrench.plots.style import (
    ADEQUATE_COLOUR,
    INK,
    LEGEND,
    MISFIT_COLOUR,
    MUTED,
    NOISE,
    NORMAL,
    SMALL,
    PanelGrid,
    label_y_axis,
    panel_title,
)

chapter = tw.reference
wrench, contact, path = chapter.body_wrench, chapter.contact_statics, chapter.path_kinematics
Equation, Equations, EquationVerdict = chapter.Equation, chapter.Equations, chapter.EquationVerdict
Errata, Erratum, ErratumProof = chapter.Errata, chapter.Erratum, chapter.ErratumProof
errata = []


def show(*things):
    """LaTeX in a notebook, plain text in a script."""
    if hasattr(builtins, "display"):
        builtins.display(*things)
    else:
        print(*things, sep="\n\n", end="\n\n")


# %% [markdown]
# ## The motion: 22.2 to 22.4
#
# World x to the right, y up; joint angles clockwise. Derived by turning link after link from the outermost inwards, and
# by differentiating in time.

# %%
motion_equations = chapter.path_equations()
show(*motion_equations)

# %% [markdown]
# ## The wrench: 22.5 to 22.9
#
# Two routes lead to what the sensor exerts on the tip. The project's model adds up Newton's law over the elements of a
# body, about the sensor origin Ps. The other route is Newton's law for the centre of mass and Euler's about it, with
# 22.4's acceleration, moved to Ps. 22.5 is held against the second, 22.7 to 22.9 against the first. The biases stand on
# both sides of 22.5 and are left out.

# %%
wrench_equations = chapter.wrench_equations()
show(*wrench_equations)

# %% [markdown]
# The axes of 22.5 could point the other way; but then row 1 errs in the weight instead of the acceleration. Row 3 gets
# more than its due: its I may be about any point. At phi = 0 it says nothing of ax, whatever its sign, and the torque
# does.

# %%
m, l_g, i_g, g = wrench.MASS, path.L_G, wrench.I_G, wrench.G
phi, ax, ay = path.PHI, path.AX, path.AY
two_routes = wrench.derived_load().subs(wrench.BODY_ABOUT_CENTRE)
lift = ax * sp.cos(phi) - (ay + g) * sp.sin(phi)
stated = sp.Matrix(
    [
        m * lift + m * l_g * path.DDPHI,
        -(m * (ax * sp.sin(phi) + (ay + g) * sp.cos(phi)) - m * l_g * path.DPHI**2),
        (i_g + m * l_g**2) * path.DDPHI + m * l_g * lift,
    ]
)
row_1, row_2, row_3 = (wrench_equations[f"22.5 {channel} - bias"] for channel in ("fx", "fy", "tau"))
left_at_zero = row_3.unmatched(row_3.differences[0])
errata.append(
    Erratum(
        1,
        "22.8 and 22.9 are right, and 22.5 is not: gravity against acceleration in row 1, sin phi in row 3",
        (
            ErratumProof.same("both routes give one wrench", two_routes, wrench.wrench_about_centre()),
            ErratumProof.same("it is (F_x', -F_y', tau) of the notes", two_routes, stated),
            ErratumProof.same("22.8 with 22.9 is that wrench", wrench_equations["22.7"].differences[0], sp.zeros(3, 1)),
            ErratumProof.other("row 1 of 22.5 is not", row_1.readings[0], row_1.derived),
            ErratumProof.other("nor is row 1 with the other sign", -row_1.readings[0], row_1.derived),
            ErratumProof.same("row 1 is off by twice m a_Gx'", row_1.differences[0][0], -2 * m * wrench.A_GX),
            ErratumProof.same(
                "or by twice the weight", -row_1.readings[0] - row_1.derived, sp.Matrix([2 * m * g * sp.sin(phi)])
            ),
            ErratumProof.same("row 2 of 22.5 is row 2 of 22.8", row_2.readings[0], sp.Matrix([two_routes[1]])),
            ErratumProof.other("row 3 lacks, for any I, at phi = 0 in ax", sp.S.Zero, left_at_zero[ax]),
        ),
    )
)

# %% [markdown]
# The I of 22.6 is printed as a letter l. What multiplies ddphi is the inertia about Ps, by the parallel axis
# theorem; with it, and only with it, a body is consistent when [[m, mlg], [mlg, I]] has no negative eigenvalue.

# %%
inertia, l_x = sp.Symbol("I", real=True), sp.Symbol("l_x", real=True)
about_ps = wrench_equations["22.6 I"].derived[0]
plane = sp.Matrix([[m, m * l_g], [m * l_g, inertia]])
whole = sp.Matrix([[m, 0, m * l_x], [0, m, m * l_g], [m * l_x, m * l_g, inertia]])
errata.append(
    Erratum(
        2,
        "I of 22.6 and 22.8 is about Ps: I = I_G + m l_g²",
        (
            ErratumProof.same("the factor of ddphi", about_ps, i_g + m * l_g**2),
            ErratumProof.other("about the centre of mass it would be another", i_g, about_ps),
            ErratumProof.same("det [[m, mlg], [mlg, I]] = m I_G", plane.det().subs(inertia, about_ps), m * i_g),
            ErratumProof.same(
                "with the centre l_x beside the axis, det of the 3 x 3 = m² I_G",
                whole.det().subs(inertia, i_g + m * (l_g**2 + l_x**2)),
                m**2 * i_g,
            ),
        ),
    )
)
show(*errata)

# %% [markdown]
# ## The series and its optimum: 22.10 and 22.17
#
# 22.10 is a definition. What can be checked is that the series this project designs with is the same one; s1 and c1
# stand for sin and cos of 2 pi t / T, s2 and c2 for those of twice that, and so on. The notes do not say whether
# x1 .. x6 come as three sines and three cosines or in turns; the peaks will.

# %%
PERIOD = 5.0
series = tw.PaperSeries(joints=3, period=PERIOD)
x = sp.Matrix(sp.symbols("x1:16", real=True))
sines, cosines = sp.symbols("s1:7", real=True), sp.symbols("c1:7", real=True)  # of i 2 pi t / T
own = [sum(x[6 + 3 * j + i] * sines[3 + i] for i in range(3)) for j in range(3)]
orders = {"sines, then cosines": (0, 1, 2, 3, 4, 5), "in turns": (0, 2, 4, 1, 3, 5)}
printed = []
for order in orders.values():
    shared = sum(x[order[i]] * sines[i] + x[order[3 + i]] * cosines[i] for i in range(3))
    printed.append(sp.Matrix([shared + of_joint for of_joint in own]))
functions = sp.Matrix([1, *sines, *cosines])
derived = sp.Matrix([functions.dot(sp.Matrix(series.mixing[j].astype(int)) * x) for j in range(3)])
series_equations = Equations((Equation(number="22.10", states="q1 .. q3", readings=tuple(printed), derived=derived),))
show(*series_equations)

# %% [markdown]
# In which unit is x_opt? Read in degrees, the joints swing by 42, 44 and 35 degrees, well within what such an arm can
# do. Read in radians, each joint would wind up by several turns. So: degrees, by inference. (The peaks of the motion
# are those between the samples too. With the coefficients in turns they would be others.)

# %%
optimum = np.degrees(series.chapter_optimum.coefficients)


def peaks(coefficients):
    """The largest angle of each joint, in the unit of the coefficients."""
    return np.abs(tw.Trajectory(series, coefficients).enclosure(0)).max(axis=0)


in_degrees, in_radians = peaks(optimum), np.degrees(peaks(optimum))
in_turns = peaks(np.concatenate([optimum[list(orders["in turns"])], optimum[6:]]))
print("read in degrees:", *(f"{peak:6.1f}°" for peak in in_degrees))
print("  x1 .. x6 in turns:", *(f"{peak:6.1f}°" for peak in in_turns))
print("read in radians:", *(f"{peak:6.0f}°" for peak in in_radians))

# %% [markdown]
# The picture: the first row fits an arm, the second does not. The shaded band is ±60, ±70, ±80 degrees, the limits
# assumed everywhere in this project; the chapter gives none.

# %%
LIMITS = np.array([60.0, 70.0, 80.0])
when = np.linspace(0, PERIOD, 600)
swing = tw.Trajectory(series, optimum).evaluate(when)[0]


def unit_figure():
    """x_opt joint by joint, read in degrees (first row) and in radians (second)."""
    sheet = PanelGrid(rows=2, columns=3, panel_height=150, between_rows=44, top=34)
    figure, panels = sheet.panels(sharex=True, sharey="row")
    turns = swing / (2 * np.pi)
    readings = (
        ("degrees", swing, "angle, °", ADEQUATE_COLOUR, 1, in_degrees),
        ("radians", turns, "angle, turns", MISFIT_COLOUR, 360, in_radians),
    )
    for row, (name, angles, label, colour, degrees, peak) in zip(panels, readings, strict=True):
        for j, axes in enumerate(row):
            axes.axhspan(-LIMITS[j] / degrees, LIMITS[j] / degrees, color=NOISE, lw=0)
            axes.plot(when / PERIOD, angles[:, j], color=colour, lw=1.4)
            top = np.argmax(np.abs(angles[:, j]))
            at, words = (when[top] / PERIOD, angles[top, j]), f"{peak[j]:.0f}°"
            axes.plot(*at, "o", color=colour, ms=4)
            axes.annotate(words, at, (8, 0), textcoords="offset points", va="center", color=INK, fontweight="bold")
            panel_title(axes, f"q{j + 1}, x_opt read in {name}", colour)
        label_y_axis(row[0], label)
        row[0].set_ylim((-90, 90) if degrees == 1 else (-8.5, 8.5))
    panels[0, 0].text(0.0, -LIMITS[0] + 3, "limits assumed, ±60°", color=MUTED, fontsize=SMALL)
    panels[1, 0].annotate(
        "the same limits",
        (0.3, -0.1),
        (0.05, -6),
        color=MUTED,
        fontsize=SMALL,
        arrowprops={"arrowstyle": "-", "color": MUTED},
    )
    for axes in panels[-1]:
        axes.set_xlabel("share of the period")
    return figure


unit_figure()

# %% [markdown]
# But the chapter reports det(M) > 1e41, and in degrees this motion does not reach it: with the lengths assumed here and
# T = 5 s it is 1e25.5 for 1000 samples and 1e31.5 for 10 000. It grows with the sixth power of the number of samples,
# so that 1e41 would take hundreds of thousands within five seconds. In radians 1000 samples do. Since the chapter gives
# neither lengths nor T nor the sampling rate, this stays open.

# %%
rig = tw.Rig.from_data(
    {
        "robot": {"link_lengths": [1.0, 0.97, 0.4]},
        "limits": {
            "position": np.radians(LIMITS).tolist(),
            "velocity": [2.0, 2.2, 3.5],
            "acceleration": [10.0, 10.0, 15.0],
        },
    }
)
experiment = tw.Experiment.of(tw.planar(rig), rig.arm)


def decades(coefficients, samples):
    """log10 det(Phi' Phi) over one period of equally spaced samples, coefficients in rad."""
    information = experiment.information(tw.Trajectory(series, coefficients), samples)
    return np.linalg.slogdet(information)[1] / np.log(10)


determinant = {
    ("degrees", 1000): decades(np.radians(optimum), 1000),
    ("degrees", 10_000): decades(np.radians(optimum), 10_000),
    ("radians", 1000): decades(optimum, 1000),
}
for (unit, samples), value in determinant.items():
    print(f"x_opt in {unit}, {samples:6} samples: det(M) = 1e{value:.1f}")
needed = 1000 * 10 ** ((41 - determinant["degrees", 1000]) / 6)
print(f"1e41 in degrees takes {needed:,.0f} samples in {PERIOD:g} s: {needed / PERIOD / 1000:.0f} kHz")

print("\nin degrees, against the limits assumed:", tw.LimitUse.of(series.chapter_optimum, rig.limits), sep="\n")


def rounded(values, digits):
    """Figures to so many digits, exact."""
    return sp.Matrix([sp.Rational(f"{value:.{digits}f}") for value in np.atleast_1d(values)])


errata.append(
    Erratum(
        5,
        "x_opt has no unit: degrees, by inference; det(M) > 1e41 is not reached that way and stays open",
        (
            ErratumProof.same(
                "peaks in degrees, rounded, are 42, 44, 35", rounded(in_degrees, 0), sp.Matrix([42, 44, 35])
            ),
            ErratumProof.other("with x1 .. x6 in turns they are others", rounded(in_turns, 0), sp.Matrix([42, 44, 35])),
            ErratumProof.same(
                "log10 det in degrees is 25.5 and 31.5 for 1000 and 10 000 samples",
                rounded([determinant["degrees", 1000], determinant["degrees", 10_000]], 1),
                rounded([25.5, 31.5], 1),
            ),
            ErratumProof.same("in radians 42 for 1000", rounded(determinant["radians", 1000], 0), sp.Matrix([42])),
            ErratumProof.other(
                "decades short of 41, in degrees, 10 000", rounded(determinant["degrees", 10_000], 1)[0], 41
            ),
        ),
    )
)
show(errata[-1])

# %% [markdown]
# Nor does the best determinant minimise the variance of each parameter. A straight line a + b t from four samples
# between t = -1 and t = 2 is enough to see it: samples at the ends make det larger, and the variance of a too. And a
# bias of a torque is not a force.

# %%
ends, middle = (sp.Matrix([[1, time] for time in times]) for times in ((2, 2, -1, -1), (1, 1, -1, -1)))
best, other = ends.T * ends, middle.T * middle
unit_of = {p.name: sp.Symbol(p.unit) for p in tw.planar().parameters}
errata.append(
    Erratum(
        8,
        "D-optimality minimises the volume of the ellipsoid, not each variance; bias_tau is in N m",
        (
            ErratumProof.other("det gained by the ends", best.det(), other.det()),
            ErratumProof.other("variance of a gained, where it should fall", best.inv()[0, 0], other.inv()[0, 0]),
            ErratumProof.other("unit of bias_tau less N", unit_of["bias_tau"], sp.Symbol("N")),
        ),
    )
)
show(errata[-1])

# %% [markdown]
# ## The contact: 22.13 to 22.16
#
# By 22.7 the contact is f - Phi theta, in the axes in which Phi theta is given. 22.13 turns Phi theta by R(-phi) first.
# That is right only where f is given in other axes than Phi theta, and the chapter does not say in which it is: open.
# The world's axes do not fit either, since 22.8's channels lie along x' and -y': the matrix that takes them to the
# world's mirrors, with determinant -1, and no R does.
#
# For 22.14 the model itself is asked what a force R (sin b, cos b) along (x', y') changes in its channels. For 22.16
# least squares, which 22.15 asks for, is done on 22.14 as printed; R at a direction b is compared without the absolute
# value that the print takes of it.

# %%
contact_equations = chapter.contact_equations()
show(*contact_equations)
to_world = sp.Matrix.hstack(path.ALONG_X, -path.ALONG_Y)
print("determinant of what takes the force channels to the world:", sp.simplify(to_world.det()))

# %%
size, b, d = contact.FORCE_SIZE, contact.ANGLE, contact.D
fc, tau = contact.CONTACT_WRENCH, contact.TAUC
printed_fc, derived_fc = contact.PRINTED_22_14, contact.derived_channels()
other_torque = sp.Matrix([[-1, 0], [0, -1], [d, 0]])  # tau = +R d sin b


def on(expression, channels):
    """The expression for these contact channels."""
    return expression.subs(dict(zip(fc, channels, strict=True)), simultaneous=True)


tangent, tan_b = contact.tangent(contact.MATRIX_22_14), sp.sin(b) / sp.cos(b)
size_along = contact.size_along(contact.MATRIX_22_14)
errata.append(
    Erratum(
        3,
        "22.16 solves tau = +R d sin b, the opposite sign of 22.14",
        (
            ErratumProof.same(
                "least squares with that torque gives 22.16", contact.PRINTED_22_16, contact.tangent(other_torque)
            ),
            ErratumProof.other("with 22.14's own torque it does not", contact.PRINTED_22_16, tangent),
            ErratumProof.same("tan b = (fcx + tau d) / (fcy (1 + d²)) inverts 22.14", on(tangent, printed_fc), tan_b),
            ErratumProof.other("22.16 does not", on(contact.PRINTED_22_16, printed_fc), tan_b),
            ErratumProof.same("its R has that torque, too", contact.PRINTED_SIZE, contact.size_along(other_torque)),
            ErratumProof.same("R of the other sign inverts 22.14", on(size_along, printed_fc), size),
            ErratumProof.other("that of 22.16 does not", on(contact.PRINTED_SIZE, printed_fc), size),
        ),
    )
)

# %% [markdown]
# arctan sees a force and its opposite as one. And 1 + d² adds a number to m²: in N mm and mm, where the force is the
# same, the formula points elsewhere. Weighted with the noise of each channel it does not care for the unit.

# %%
noises = sp.symbols("sigma_x sigma_y sigma_tau", positive=True)
unit = sp.Symbol("u", positive=True)  # how many of the unit of length in a metre
weights = sp.diag(*(1 / s**2 for s in noises))
weighted = contact.least_squares(contact.MATRIX_22_14, weights)
plain = contact.least_squares(contact.MATRIX_22_14)
millimetres = {d: unit * d, tau: unit * tau}
in_noise = {noises[2]: unit * noises[2]}
errata.append(
    Erratum(
        4,
        "arctan loses the quadrant, and 1 + d² weighs 1 N like 1 N m; 22.14 holds in the tip frame",
        (
            ErratumProof.same("tan of a contact and of its opposite are one", tangent, on(tangent, -fc)),
            ErratumProof.other("their (R sin b, R cos b) are not", plain, on(plain, -fc)),
            ErratumProof.other(
                "another unit of length (1000 in a metre), another tan",
                tangent.subs(millimetres, simultaneous=True).subs(unit, 1000),
                tangent,
            ),
            ErratumProof.same(
                "weighted with the noise: the same in any unit",
                weighted.subs({**millimetres, **in_noise}, simultaneous=True),
                weighted,
            ),
            ErratumProof.same("in the tip frame no angle of the tip enters", derived_fc.diff(phi), sp.zeros(3, 1)),
        ),
    )
)

# %%
mirrored = size * sp.Matrix([sp.sin(sp.pi - b), sp.cos(sp.pi - b)])
corrected = sp.Matrix([-(fc[0] + tau * d) / (1 + d**2), fc[1]])
example = {size: 5, b: sp.Rational(3, 10), d: sp.Rational(1, 5)}
returned = float(sp.atan2(*on(plain, derived_fc).subs(example)))
print(f"a force at 0.30 rad comes out of 22.14 at {returned:.2f} rad")
errata.append(
    Erratum(
        7,
        "22.14 does not fit 22.8: on its channels it returns pi - b (0.30 becomes 2.84)",
        (
            ErratumProof.other("22.14 less what a contact changes in 22.8's channels", printed_fc, derived_fc),
            ErratumProof.same("22.14 solved for those channels gives pi - b", on(plain, derived_fc), mirrored),
            ErratumProof.same("0.30 becomes 2.84", rounded(returned, 2), rounded(2.84, 2)),
            ErratumProof.same(
                "atan2(-(fcx + tau d) / (1 + d²), fcy) gives b", on(corrected, derived_fc), contact.FORCE_COMPONENTS
            ),
        ),
    )
)
show(*errata[-3:])

# %% [markdown]
# ## Table 22.1: what averaging does not remove
#
# Ten of the single runs leave residuals of variance (0.6705, 2.654) N² on average, the mean of all 30 (0.037, 0.110)
# N². If noise is independent between runs, averaging n of them divides its variance by n. What comes back in every run
# stays. That is two equations for two unknowns in each channel,
#
# single = noise + remainder², averaged = noise / 30 + remainder².

# %%
RUNS = 30
ten_runs = np.array(
    [
        [0.819, 0.469, 0.672, 0.740, 0.575, 0.697, 0.778, 0.658, 0.644, 0.653],
        [2.207, 3.435, 2.170, 3.645, 2.610, 2.516, 2.784, 2.320, 2.202, 2.649],
    ]
)
single, averaged = ten_runs.mean(axis=1), np.array([0.037, 0.110])
noise = (single - averaged) / (1 - 1 / RUNS)
squared = averaged - noise / RUNS
remainder = np.sqrt(squared)
shared_noise = squared / single
for name, values in {"noise variance, N²": noise, "remainder, N": remainder}.items():
    print(f"{name:20} fx {values[0]:.3f}   fy {values[1]:.3f}")
print("or noise shared by all runs: a correlation between runs of", *(f"{100 * c:.1f} %" for c in shared_noise))

# %% [markdown]
# How sure is that? A variance of N independent samples errs by sqrt(2/N) of itself, and noise/30 is what is left of the
# noise in the mean of the runs. With n = 30 runs, and K of them behind the mean 0.6705,
#
# std(remainder²) = noise/n · sqrt(2/N) · sqrt(n² - 2n + n²/K) / (n - 1).
#
# The last factor is 1.02 when all 30 runs are behind it, 1.05 for ten and 1.44 for a single one. N is not given, nor is
# the sampling rate. The project's notes say ±0.005 and ±0.018 N and not where these come from; one N fits them in both
# channels, about 560 with K = 30. So they hold if the residuals of a run count as some 560 independent ones, and go
# with 1/sqrt(N) otherwise. The ten variances tell N, too: they scatter by sqrt(2/N) of themselves, as those of far
# fewer.
#
# That is the error of a remainder of zero, the one that says whether there is any. One that is there also beats with
# the noise that is left in the same mean, which makes its size less certain: 4 remainder² noise/n joins 2 (noise/n)².


# %%
def error_of_remainder(samples, singles=RUNS, beating=False):
    """Standard error of the remainder (2,), N, from so many independent samples of a run, by d(r²) = 2 r dr.

    remainder² = (n averaged - single) / (n - 1). Of n runs with noise s each, the mean square of the average has
    variance 2 (s/n)² / N, that of K single runs 2 s² / (N K), and the two a covariance of 2 (s/n)² / N.
    """
    left, n = noise / RUNS, RUNS
    variance = 2 * left**2 * (n**2 - 2 * n + n**2 / singles) / (n - 1) ** 2
    if beating:
        variance = variance + 4 * squared * left * (n**2 - 2 * n + n / singles) / (n - 1) ** 2
    return np.sqrt(variance / samples) / (2 * remainder)


stated_error, half_digit = np.array([0.005, 0.018]), 0.0005
least, most = (((error_of_remainder(1) / (stated_error + sign * half_digit)) ** 2) for sign in (1, -1))
SAMPLES = 560
error, with_beating = error_of_remainder(SAMPLES), error_of_remainder(SAMPLES, beating=True)
windows = (f"{a:.0f} to {z:.0f} by {name}" for name, a, z in zip(("fx", "fy"), least, most, strict=True))
print("the ± of the notes, rounded as they are, ask for N of", " and ".join(windows))
for name, r, e, w, q in zip(("fx", "fy"), remainder, error, with_beating, squared, strict=True):
    sigmas = q / (2 * r * e)
    print(f"{name}: {r:.3f} ± {e:.3f} N (± {w:.3f} with the beating), remainder² at {sigmas:.0f} standard errors")
of_runs = 2 / np.mean((ten_runs.std(axis=1, ddof=1) / single) ** 2)
wider = error_of_remainder(of_runs, singles=10)
for name, r, e, q in zip(("fx", "fy"), remainder, wider, squared, strict=True):
    print(f"{name}, N = {of_runs:.0f} as the runs scatter: {r:.3f} ± {e:.3f} N, remainder² at {q / (2 * r * e):.1f}")
print("from the printed digits alone: ±", *(f"{v:.3f}" for v in half_digit * RUNS / (RUNS - 1) / (2 * remainder)), "N")

# %% [markdown]
# So the remainder in fx is beyond doubt, and that in fy only if N is as large as the notes have it. The
# [published tables](09_published.ipynb) go on from here.
#
# Simulated tables say whether these errors are right: 400 of them with such a remainder, locked to the motion, and 400
# without.

# %%
rng = np.random.default_rng(0)
locked = np.sqrt(2) * np.sin(2 * np.pi * 5 * np.arange(SAMPLES) / SAMPLES)
spread, expected = {}, {}
for name, part in {"no remainder": 0.0, "remainder": 1.0}.items():
    tables = []
    for _ in range(400):
        # One channel is enough: the other has another scale only.
        runs = part * remainder[0] * locked + rng.normal(0, np.sqrt(noise[0]), (RUNS, SAMPLES))
        of_one, of_mean = (runs**2).mean(), (runs.mean(axis=0) ** 2).mean()
        tables.append(of_mean - (of_one - of_mean) / (RUNS - 1))
    spread[name] = np.std(tables, ddof=1)
    expected[name] = 2 * remainder[0] * error_of_remainder(SAMPLES, beating=bool(part))[0]
    print(f"{name:13} std of remainder²: {spread[name]:.2e} N² simulated, {expected[name]:.2e} N² by the formula")

# %%
errata.append(
    Erratum(
        6,
        "Table 22.1 holds a remainder of 0.123 and 0.149 N that averaging does not remove",
        (
            ErratumProof.same("noise, rounded", rounded(noise, 3), rounded([0.655, 2.632], 3)),
            ErratumProof.same("remainder, rounded", rounded(remainder, 3), rounded([0.123, 0.149], 3)),
            ErratumProof.same(
                "its error, with one N for both channels, rounded", rounded(error, 3), rounded([0.005, 0.018], 3)
            ),
            ErratumProof.other("remainder² is not zero", rounded(squared, 4), sp.zeros(2, 1)),
        ),
    )
)
show(errata[-1])

# %% [markdown]
# The picture: without a remainder the mean of 30 runs would lie on the dashed line. It lies above, and no number of
# runs would bring it below the floor. The floor is physics that the model misses, or interference locked to the motion.
# The notes give no figures for the torque, and say that it shows nothing.


# %%
def floor_figure():
    """Variance of the residual against the number of runs averaged, with the two figures of Table 22.1."""
    sheet = PanelGrid(rows=1, columns=2, panel_height=260, top=30, between_columns=40)
    figure, (panels,) = sheet.panels(sharex=True, sharey=True)
    count = np.geomspace(1, 1000, 200)
    for i, (axes, name) in enumerate(zip(panels, ("fx", "fy"), strict=True)):
        axes.axhspan(1e-4, squared[i], color=NOISE, lw=0)
        axes.loglog(count, noise[i] / count, color=MUTED, lw=1.0, ls=(0, (4, 3)), label="noise alone, as 1/n")
        axes.loglog(
            count, noise[i] / count + squared[i], color=ADEQUATE_COLOUR, lw=1.6, label="noise, and what comes back"
        )
        axes.plot([1, RUNS], [single[i], averaged[i]], "o", color=MISFIT_COLOUR, ms=6, zorder=3, label="Table 22.1")
        for runs, value, words in ((1, single[i], "single runs"), (RUNS, averaged[i], f"mean of {RUNS} runs")):
            text = f"{words}\n{value:.4g} N²"
            axes.annotate(text, (runs, value), (8, 4), textcoords="offset points", color=MISFIT_COLOUR, fontsize=SMALL)
        floor = f"averaging does not remove {squared[i]:.3f} N²\n= ({remainder[i]:.3f} ± {error[i]:.3f} N)²"
        axes.text(1.1, 1.6e-3, floor, color=INK, fontsize=NORMAL, fontweight="bold")
        axes.set(ylim=(1e-3, 6), xlim=(0.85, 1000), xlabel="runs averaged, n")
        axes.legend(**LEGEND, loc="upper right")
        panel_title(axes, name)
    label_y_axis(panels[0], "variance of the residual, N²")
    return figure


floor_figure()

# %% [markdown]
# ## Everything at once

# %%
equations = Equations((*motion_equations, *wrench_equations, *series_equations, *contact_equations))
show(equations)

# %%
all_errata = Errata(tuple(sorted(errata, key=lambda erratum: erratum.number)))
show(all_errata)
wrong = [e.number for e in equations if e.verdict in (EquationVerdict.ERRATUM, EquationVerdict.NOT_DERIVABLE)]
print(f"\n{len(all_errata.members)} errata, all shown: {all_errata.proven}; equations at fault:", *dict.fromkeys(wrong))

# %% [markdown]
# ## The answer
#
# Of the equations checked eleven agree with the derivation; 22.5, 22.6, 22.14 and 22.16 do not. Whether 22.13 does
# depends on axes that the chapter does not state. Eight errata are shown, each by a difference. The project computes
# with what it derives, and with nothing that is typed from the chapter.
