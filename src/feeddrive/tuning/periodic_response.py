"""The frequency response of a controller whose matrices repeat with a period of N samples, in a loop with its axis.

A slow part of a controller, such as a position loop that runs every N-th sample, reads few values once per period.  The
rest is time-invariant.  The harmonics are therefore those of a time-invariant controller plus a matrix of low rank, and
the loops at the images are closed by the Woodbury identity instead of solving N equations for each line.
"""

from typing import NamedTuple

import numpy as np

from feeddrive.loop.gradient import Resolvent

# of the terms that an entry of a matrix is the sum of: derivatives have rounding errors of 1e-13, and with a smaller
# share these would be taken for four times as many products
_ROUNDING = 1e-11
_BLOCK = 2**12  # lines times images computed at once: the arrays of a block then stay in the cache


class PeriodicResponse(NamedTuple):
    """The response from readings to force, with the loops at the images closed.

    value  shape (readings, lines)
    slope  derivatives with respect to the tunables, shape (readings, lines, tunables)
    rest   det(1 + L) of the images, shape (lines,)
    poles  eigenvalues of the controller over a period
    """

    value: np.ndarray
    slope: np.ndarray
    rest: np.ndarray
    poles: np.ndarray


def periodic_response(
    samples: np.ndarray, slopes: np.ndarray, cycles: np.ndarray, images: list[int], axis: np.ndarray
) -> PeriodicResponse:
    """Return C(f), its derivatives and det(1 + L) of the images.

        C(f) = C₀₀ + C₀ᵢ X R Cᵢ₀,   R = (1 + Lᵢᵢ)⁻¹,   ∂C(f) = [1, C₀ᵢ X R] ∂C [1; X R Cᵢ₀]

    samples  [A B; c d] of each sample of a period, shape (N, n + 1, n + r) for r readings
    slopes   their derivatives, shape (N, n + 1, n + r, tunables)
    cycles   f T of each line
    images   the images m of f + m/(NT) whose loops are closed
    axis     the responses X of the readings to the force at these images, shape (r, lines, images)
    """
    parts = _Parts(samples)
    changes = _Changes(samples, slopes)
    blocks = max(1, round(cycles.size * len(samples) / _BLOCK))
    values: list[np.ndarray] = []
    moved: list[np.ndarray] = []
    rest: list[np.ndarray] = []
    for block in np.array_split(np.arange(cycles.size), blocks):
        closed = parts.closed(cycles[block], images, axis[:, block].transpose(2, 0, 1))
        values.append(closed.value)
        rest.append(closed.rest)
        moved.append(changes.of(closed, cycles[block], images))
    return PeriodicResponse(
        np.concatenate(values, axis=1), np.concatenate(moved, axis=1), np.concatenate(rest), changes.poles
    )


class _Closed(NamedTuple):
    """The result of closing the loops at the images; the last axis is that of the lines.

    value     the response of each of r readings at the line itself, (r, lines)
    readings  the readings at each image for a unit reading at the line, (images, r readings, r, lines)
    counts    how a force at each image counts at the line, (images, lines)
    rest      det(1 + L) of the images
    """

    value: np.ndarray
    readings: np.ndarray
    counts: np.ndarray
    rest: np.ndarray


class _Parts:
    """A periodic controller, split into a time-invariant controller and the deviations from it.

    The time-invariant part has the matrices of the last sample and the states that the readings can reach by repeating
    it. All other states are slow.  `taken` lists the inputs, each one column of one sample, through which the
    controller deviates from its time-invariant part or sets slow states; there are few of them, since a position loop
    runs once per period. With the slow states s at the start of a period and the input values w of that period

        ζ s = S s + Q w,   force and fast states get η_k = V (P_k s + G_k w) in sample k,   ζ = z^N

    V, `along`, has few columns: what a slow part gives, such as a set velocity, enters at one place.
    """

    def __init__(self, samples: np.ndarray) -> None:
        N, n = len(samples), samples.shape[1] - 1
        last = samples[-1]
        fast = _reached(last)
        rows = np.append(np.flatnonzero(fast), n)
        columns = np.append(np.flatnonzero(fast), np.arange(n, samples.shape[2]))
        slow = np.flatnonzero(~fast)
        self.period, self.many = N, int(np.count_nonzero(fast))
        self.base = last[np.ix_(rows, columns)]
        apart = samples[:, :, columns] - last[:, columns]
        self.taken = np.argwhere(np.any(apart != 0.0, axis=1))
        W, s = len(self.taken), slow.size
        # the slow states from those at the start of the period, and from the numbers taken
        through = np.eye(s, s + W)
        given = np.zeros((N, rows.size, s + W))
        for k in range(N):
            new = np.zeros((n + 1, W))
            for place, (sample, column) in enumerate(self.taken):
                if sample == k:
                    new[:, place] = apart[k, :, column]
            given[k] = samples[k][np.ix_(rows, slow)] @ through
            given[k, :, s:] += new[rows]
            through = samples[k][np.ix_(slow, slow)] @ through
            through[:, s:] += new[slow]
        self.slow, self.set = through[:, :s], through[:, s:]
        pairs = _products(given.transpose(1, 0, 2).reshape(1, rows.size, N * (s + W)))
        self.along = np.array([column for _, column, _ in pairs]).reshape(-1, rows.size).T
        self.given = np.array([row for _, _, row in pairs]).reshape(-1, N, s + W).transpose(1, 0, 2)

    def closed(self, cycles: np.ndarray, images: list[int], axis: np.ndarray) -> _Closed:
        """Return the response with the loops at the images closed, for lines at f T = cycles."""
        N, n, W = self.period, self.many, len(self.taken)
        lines, many = cycles.size, len(images)
        states = [int(column) for _, column in self.taken if column < n]
        # the numbers taken from fast states sum over all images, those taken from readings over the closed ones
        every = [0, *images, *(m for m in range(1, N) if m not in images)] if states else [0, *images]
        turn = cycles + np.array(every)[:, None] / N  # of z at each image, (images, lines)
        A, B, c, d = self.base[:n, :n], self.base[:n, n:], self.base[n:, :n], self.base[n, n:]
        picked = np.concatenate([c, np.eye(n)[states]])
        inner, readings = np.concatenate([B, self.along[:n]], axis=1), axis.shape[1]
        answers = Resolvent(A, np.exp(2j * np.pi * turn).ravel()).between(picked, inner)
        answers = answers.reshape(inner.shape[1], len(picked), *turn.shape)
        direct = answers[:readings, 0] + d[:, None, None]
        given = self._given(cycles, every)
        force = np.einsum("vmf,mvwf->mwf", answers[readings:, 0] + self.along[n][:, None, None], given)
        # what each number taken hears of the readings at each image, and of itself through the fast states
        hears = np.zeros((len(every), W, readings, lines), complex)
        own = np.broadcast_to(np.eye(W), (lines, W, W)).astype(complex)
        state = 0
        for place, (sample, column) in enumerate(self.taken):
            phase = np.exp(2j * np.pi * sample * turn)
            if column < n:
                state += 1
                heard = phase * answers[:, state]
                hears[:, place] = heard[:readings].transpose(1, 0, 2)
                own[:, place] -= np.einsum("vmf,mvwf->fw", heard[readings:], given)
            else:
                hears[:, place, column - n] = phase
        single = 1.0 - np.sum(axis * direct[:, 1 : 1 + many].transpose(1, 0, 2), axis=1)  # 1 + L of the fast part
        share = axis / single[:, None]
        by_force = np.sum(hears[1 : 1 + many] * share[:, None], axis=2)  # (images, W, lines)
        loop = own - np.einsum("mvf,mwf->fvw", by_force, force[1 : 1 + many])
        # what is taken for a unit reading at the line, and how the numbers taken count there
        back = np.linalg.solve(loop, hears[0].transpose(2, 0, 1)).transpose(1, 2, 0)
        ahead = np.linalg.solve(loop.transpose(0, 2, 1), force[0].T[:, :, None])[:, :, 0].T
        value = direct[:, 0] + np.einsum("wf,wrf->rf", force[0], back)
        forces = np.einsum("mwf,wrf->mrf", force[1 : 1 + many], back)
        counts = np.einsum("wf,mwf->mf", ahead, by_force)
        rest = np.prod(single, axis=0) * np.linalg.det(loop) / np.linalg.det(own)
        return _Closed(value, share[:, :, None] * forces[:, None], counts, rest)

    def _given(self, cycles: np.ndarray, images: list[int]) -> np.ndarray:
        """Return the harmonics of P s + G w for unit input values w, shape (images, columns of V, W, lines)."""
        N, s, W = self.period, self.slow.shape[0], len(self.taken)
        lines = cycles.size
        start = Resolvent(self.slow, np.exp(2j * np.pi * N * cycles)).after(self.set).transpose(1, 2, 0)
        rows = self.given.shape[1]
        # real times complex, as real numbers
        flat = np.ascontiguousarray(start).reshape(s, W * lines).view(float)
        over_time = (self.given[:, :, :s].reshape(N * rows, s) @ flat).view(complex)
        over_time = over_time.reshape(N, rows, W, lines) + self.given[:, :, s:, None]
        over_time *= np.exp(-2j * np.pi * np.arange(N)[:, None] * cycles)[:, None, None]
        waves = np.exp(-2j * np.pi / N * np.outer(images, np.arange(N))) / N
        return (waves @ over_time.reshape(N, rows * W * lines)).reshape(len(images), rows, W, lines)


class _Changes:
    """The derivatives of a periodic controller along its motion over a period.

        ∂C = Σ_k [λ_k, μ_k] ∂[A B; c d]_k [x_k; r_k],   x_(k+1) = A_k x_k + B_k r_k,   λ_(k-1) = λ_k A_k + μ_k c_k

    x and λ are multiplied by ζ = z^N over a period; μ_k is the weight of the force in sample k.  A tunable acts through
    few combinations of states, so that its ∂[A B; c d]_k are products of few columns and rows (`_products`).
    """

    def __init__(self, samples: np.ndarray, slopes: np.ndarray) -> None:
        self.samples = samples
        N, n, self.tunables = len(samples), samples.shape[1] - 1, slopes.shape[3]
        inputs = samples.shape[2]
        self.whole = np.eye(n)
        for matrix in samples:
            self.whole = matrix[:n, :n] @ self.whole
        self.poles = np.linalg.eigvals(self.whole) if n else np.zeros(0)
        pairs = _products(slopes.transpose(3, 1, 0, 2).reshape(self.tunables, n + 1, N * inputs))
        self.of_tunable = np.array([tunable for tunable, _, _ in pairs], int)
        self.columns = np.array([column for _, column, _ in pairs]).reshape(-1, n + 1)
        rows = np.array([row for _, _, row in pairs]).reshape(-1, N, inputs)
        self.rows = np.ascontiguousarray(rows.transpose(1, 0, 2))

    def of(self, closed: _Closed, cycles: np.ndarray, images: list[int]) -> np.ndarray:
        """Return the derivatives at lines f T = cycles, shape (readings, lines, tunables)."""
        N, r, lines = len(self.samples), *closed.value.shape
        slope = np.zeros((self.tunables, r, lines), complex)
        if not self.of_tunable.size:
            return slope.transpose(1, 2, 0)
        turn = np.exp(2j * np.pi * np.arange(N)[:, None] * cycles)
        waves = np.exp(2j * np.pi / N * np.outer(np.arange(N), images))
        own = np.broadcast_to(np.eye(r)[:, :, None], (r, r, lines))
        readings = (waves @ closed.readings.reshape(len(images), r * r * lines)).reshape(N, r, r, lines) + own
        counts = turn.conj() * (waves.conj() @ closed.counts + 1.0) / N
        inverse = Resolvent(self.whole, np.exp(2j * np.pi * N * cycles))
        # derivatives are real: products of real matrices with the real and imaginary parts side by side
        motion = (self.rows @ self._forward(turn[:, None, None] * readings, inverse)).view(complex)
        weights = (self.columns @ self._backward(counts, inverse)).view(complex)
        each = np.einsum("kpf,kprf->prf", weights, motion.reshape(N, -1, r, lines))
        np.add.at(slope, self.of_tunable, each)
        return slope.transpose(1, 2, 0)

    def _forward(self, readings: np.ndarray, inverse: Resolvent) -> np.ndarray:
        """Return states and readings before each sample, as real numbers of shape (N, n + r, 2 · r · lines)."""
        N, n = len(self.samples), self.samples.shape[1] - 1
        motion = np.zeros((N, self.samples.shape[2], *readings.shape[2:]), complex)
        motion[:, n:] = readings
        flat = motion.reshape(N, motion.shape[1], -1).view(float)
        if not n:
            return flat
        for k in range(N - 1):
            flat[k + 1, :n] = self.samples[k, :n] @ flat[k]
        end = (self.samples[-1, :n] @ flat[-1]).view(complex).reshape(n, *readings.shape[2:])
        start = inverse.after(end.transpose(2, 0, 1)).transpose(1, 2, 0)
        step = np.ascontiguousarray(start).reshape(n, -1).view(float)
        for k in range(N):
            flat[k, :n] += step
            step = self.samples[k, :n, :n] @ step
        return flat

    def _backward(self, counts: np.ndarray, inverse: Resolvent) -> np.ndarray:
        """Return the weights of states and force after each sample, as real numbers of shape (N, n + 1, 2 · lines)."""
        N, n = len(self.samples), self.samples.shape[1] - 1
        weights = np.zeros((N, n + 1, counts.shape[1]), complex)
        weights[:, n] = counts
        flat = weights.view(float)
        if not n:
            return flat
        for k in range(N - 1, 0, -1):
            flat[k - 1, :n] = self.samples[k, :, :n].T @ flat[k]
        start = (self.samples[0, :, :n].T @ flat[0]).view(complex)
        end = inverse.before(start.T[:, None])[:, 0].T
        step = np.ascontiguousarray(end).view(float)
        for k in range(N - 1, -1, -1):
            flat[k, :n] += step
            step = self.samples[k, :n, :n].T @ step
        return flat


def _products(matrices: np.ndarray) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Return indices p, columns l and rows r with Σ l rᵀ = matrices[p], by elimination with complete pivoting.

    The elimination ends when the error of each entry is at most `_ROUNDING` times the sum of its terms' magnitudes.
    """
    products: list[tuple[int, np.ndarray, np.ndarray]] = []
    scale = np.max(np.abs(matrices), axis=1, initial=0.0)
    scale = np.where(scale > 0.0, scale, 1.0)
    place = np.arange(len(matrices))
    left, size = matrices.copy(), np.abs(matrices)
    while True:
        more = np.any(np.abs(left) > _ROUNDING * size, axis=(1, 2))
        if not np.any(more):
            return products
        place, left, size, scale = place[more], left[more], size[more], scale[more]
        each = np.arange(place.size)
        i, j = np.unravel_index(
            np.argmax((np.abs(left) / scale[:, None]).reshape(place.size, -1), axis=1), left.shape[1:]
        )
        columns, rows = left[each, :, j] / left[each, i, j][:, None], left[each, i]
        products += zip(place.tolist(), columns, rows, strict=True)
        term = columns[:, :, None] * rows[:, None]
        left, size = left - term, size + np.abs(term)
        # the pivot's own row and column are zero but for rounding
        left[each, i], left[each, :, j] = 0.0, 0.0


def _reached(matrix: np.ndarray) -> np.ndarray:
    """Return True for each state that the readings reach by repeating one sample [A B; c d]."""
    n = matrix.shape[0] - 1
    reached = np.any(matrix[:n, n:] != 0.0, axis=1)
    for _ in range(n):
        reached |= np.any(matrix[:n, :n][:, reached] != 0.0, axis=1)
    return reached
