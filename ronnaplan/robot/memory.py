"""What a least-squares estimate is worth when its noise has a memory, as a tracker's filtered and drifting poses have.

The noise is taken as part white, part with a memory of unknown length (a first- or second-order Markov process, up to
a drift over the whole recording). In the frequencies of the discrete cosine transform such noise is all but
uncorrelated, whatever its memory (Ahmed, Natarajan & Rao 1974, IEEE Trans. Comput. C-23:90), so every member of the
family is a list of variances. Each is weighed by its restricted likelihood (Harville 1977, JASA 72:320), which counts
what the fit itself took away. Only the slow frequencies that the estimate uses are judged: nothing is concluded from
the fast ones, where a tracker's filter hides the noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ronnaplan.geometry import FloatArray

WHITE_SHARES = (0.0, 0.003, 0.03, 0.1, 0.3, 0.5, 0.7, 0.9)
MEMORIES = 10
"""Lengths of memory that are tried, from one pose to half the recording."""
ORDERS = (1, 2)
USED_LEVERAGE = 0.99
"""The estimate uses the lowest frequencies that make up so much of its leverage ..."""
BAND = 3
"""... and the noise is judged over so many times as many."""
FEWEST_FREQUENCIES = 8
SHAPE_ROUNDS = 4
FEWEST_FOR_SHAPE = 4
"""Unlike components are only considered with so many frequencies for each of them."""


def least_squares_covariance(designs: Sequence[FloatArray], residuals: Sequence[FloatArray]) -> FloatArray:
    """Return the covariance (p, p) of a least-squares estimate from N successive vector equations.

    ``designs`` (N, c, p) and ``residuals`` (N, c) are the same equations in one frame or more (of the tracker, of the
    tool). The noise is stationary in one of them, its components alike or not: each is a candidate, and the
    result is the average over all candidates and spectra by their likelihood.
    """
    weights, covariances = [], []
    frames = [_Equations(design, residual) for design, residual in zip(designs, residuals, strict=True)]
    count = max(
        frame.used for frame in frames
    )  # alike in all frames, or their likelihoods would be of unlike data
    for slow in [_SlowEquations(frame, count) for frame in frames]:
        for shape in slow.component_shapes():
            log_weights, variances = slow.judge(shape)
            top = log_weights.max()
            share = np.exp(log_weights - top)
            weights.append(top + np.log(share.sum()))
            covariances.append(slow.covariance(shape, (share * variances) @ slow.spectra / share.sum()))
    share = np.exp(np.array(weights) - max(weights))
    averaged: FloatArray = np.einsum("m,mij->ij", share / share.sum(), np.array(covariances))
    return averaged


class _Equations:
    """The frequencies of equations (N, c, p), the estimate's covariance for noise of unit variance, and who is used."""

    def __init__(self, design: FloatArray, residual: FloatArray) -> None:
        from scipy.fft import dct

        self.design = dct(design, axis=0, norm="ortho")
        self.residual = dct(residual, axis=0, norm="ortho")
        self.bread = np.linalg.inv(np.einsum("kci,kcj->ij", self.design, self.design))
        leverage = np.einsum("kci,ij,kcj->k", self.design, self.bread, self.design)
        lowest = int(np.searchsorted(np.cumsum(leverage), USED_LEVERAGE * leverage.sum()))
        self.used = min(BAND * lowest + FEWEST_FREQUENCIES, len(design))


class _SlowEquations:
    """The slowest ``count`` frequencies of equations, and the family of M noise spectra over them."""

    def __init__(self, frame: _Equations, count: int) -> None:
        self.bread = frame.bread
        self.design, self.residual = frame.design[:count], frame.residual[:count]
        self.spectra = _spectra(len(frame.design))[:, :count]

    def judge(self, shape: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the log weight (M,) and the variance (M,) of every spectrum, for components of ``shape`` (c, c)."""
        (count, size), unknowns = self.residual.shape, self.design.shape[2]
        normal, score, square = self._normal_equations(shape, self.spectra)
        misfit = square - (score * np.linalg.solve(normal, score[..., None])[..., 0]).sum(axis=1)
        freedom = count * size - unknowns
        volume = size * np.log(self.spectra).sum(axis=1) + np.linalg.slogdet(normal)[1]
        parameters = 0 if np.array_equal(shape, np.eye(size)) else size * (size + 1) / 2 - 1
        log_weights = -0.5 * (freedom * np.log(misfit) + volume + parameters * np.log(count))  # Schwarz's penalty
        log_weights[0] += np.log(len(self.spectra) - 1)  # white noise is as likely beforehand as all with a memory
        return log_weights, misfit / freedom

    def covariance(self, shape: FloatArray, spectrum: FloatArray) -> FloatArray:
        """Return the estimate's covariance (p, p) under noise of ``spectrum`` (K,) and ``shape`` (c, c).

        A shape that was itself estimated makes the covariance's inverse too large on average (Kaufman 1967; the mean
        of an inverse Wishart matrix), so it is widened by as much.
        """
        count, size = self.residual.shape
        freedom = count - self.design.shape[2] / size
        widened = 1.0 if np.array_equal(shape, np.eye(size)) else freedom / (freedom - size - 1)
        scores = (
            np.einsum("kai,ab->kbi", self.design, np.linalg.cholesky(shape)) * np.sqrt(spectrum)[:, None, None]
        )
        spread: FloatArray = self.bread @ np.einsum("kbi,kbj->ij", scores, scores) @ self.bread
        return widened * spread

    def component_shapes(self) -> list[FloatArray]:
        """Return the candidates (c, c), of determinant one, for the covariance of the noise's components."""
        count, size = self.residual.shape
        shapes = [np.eye(size)]
        for _ in range(SHAPE_ROUNDS if count >= FEWEST_FOR_SHAPE * size else 0):
            best = self.spectra[[self.judge(shapes[-1])[0].argmax()]]
            normal, score, _ = self._normal_equations(shapes[-1], best)
            left = self.residual - self.design @ np.linalg.solve(normal[0], score[0])
            covariance = (left.T / best) @ left
            shapes.append(covariance / np.exp(np.linalg.slogdet(covariance)[1] / size))
        return [shapes[0], *shapes[1:][-1:]]

    def _normal_equations(
        self, shape: FloatArray, spectra: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return normal matrices (M, p, p), right sides (M, p) and squares (M,), one for each spectrum."""
        joined = np.concatenate([self.design, self.residual[..., None]], axis=2)
        whitened = np.linalg.inv(np.linalg.cholesky(shape)) @ joined
        rows, columns = np.triu_indices(joined.shape[2])
        sums = (1 / spectra) @ np.einsum("kci,kci->ki", whitened[..., rows], whitened[..., columns])
        full = np.empty((len(spectra), joined.shape[2], joined.shape[2]))
        full[:, rows, columns] = full[:, columns, rows] = sums
        return full[:, :-1, :-1], full[:, :-1, -1], full[:, -1, -1]


def _spectra(count: int) -> FloatArray:
    """Return the family's variances (M, count), one for each frequency, of mean one; white noise first."""
    frequency = 2 * np.sin(np.pi * np.arange(count) / (2 * count))
    family = [np.ones(count)]
    for memory in np.geomspace(1.0, count / 2, MEMORIES):
        for order in ORDERS:
            with_memory = (memory**-2 + frequency**2) ** -float(order)
            with_memory /= with_memory.mean()
            family += [white + (1 - white) * with_memory for white in WHITE_SHARES]
    return np.array(family)
