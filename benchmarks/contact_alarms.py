"""How often a contact is found where there is none, and where there is one: `python -m benchmarks.contact_alarms`.

Records of noise alone and with a rectangular push of 3.5 s, 10 and 20 s long, 3 and 6 channels, noise of every model of
the simulated rig with unit variance. The rate stated for false contacts is 1 % of records at the most.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from estimation.contact.contact_detection import detect_contacts
from truewrench.simulated_rig import NOISE_MODELS

Array = NDArray[np.float64]

STEP = 0.01
PUSHES = (1.0, 3.0)
"""Height of a push in the noise's std."""


def found(residual: Array) -> bool:
    """Whether any contact is found in a residual of unit noise."""
    size = residual.shape[1]
    return bool(detect_contacts(residual, STEP, floor=np.ones(size), remainder=np.zeros(size)).intervals)


def drawn(kind: str, samples: int, channels: int, seed: int) -> Array:
    """Noise (samples, channels) of unit variance."""
    return NOISE_MODELS[kind].draw(np.random.default_rng([seed, samples, channels]), samples, channels)


def share(hits: int, records: int) -> str:
    """A rate with its 95 % interval (Clopper and Pearson), in per cent."""
    interval = binomtest(hits, records).proportion_ci()
    return f"{100 * hits / records:5.1f} % [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"


def main() -> None:
    """Print a line for each kind of record."""
    parser = argparse.ArgumentParser(description="false and true contacts in noise of several kinds")
    parser.add_argument("--records", type=int, default=100, help="records of each kind (default: %(default)s)")
    records = parser.parse_args().records
    print(
        f"{'noise':16} {'samples':>7} {'channels':>8}  none there           "
        + "".join(f"  push of {p} std   " for p in PUSHES)
    )
    for kind in NOISE_MODELS:
        for samples, channels in ((1000, 3), (1000, 6), (2000, 3)):
            alone = [drawn(kind, samples, channels, seed) for seed in range(records)]
            rates = [share(sum(map(found, alone)), records)]
            for height in PUSHES:
                push = np.zeros((samples, channels))
                push[samples // 3 : samples // 3 + 350, 0] = height
                few = max(1, records // 5)
                rates.append(share(sum(found(noise + push) for noise in alone[:few]), few))
            print(f"{kind:16} {samples:7} {channels:8}  " + "  ".join(rates), flush=True)


if __name__ == "__main__":
    main()
