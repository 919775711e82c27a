"""Best-first growth in compiled code: what `growth` does in torch, for many items, without the interpreter.

Nothing here depends on the number of threads: an item is grown by one thread, in a fixed order of operations.
Scratch arrays are made once per call and serve all items of it.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from torchlight.compiled import compiled

# as in the twin and below it, written out: numba keeps compiled code until this file changes
UNKNOWN = -1
TEXEL = -2
RESOLVED, BELOW_THRESHOLD, ILL_CONDITIONED, UNSEEN, LIMIT = range(5)
WAVELETS = 3
ALWAYS_ASKED = 4
ASKED_ENERGY = 100.0
LEAST_PRIOR = 0.3
LEAST_REACH = 0.05
REACH = 2.0
FLOOR = 1e-9
RIDGE = 1e-12
TOLERANCE = 1e-11
CHANCES = 3
PIVOTINGS = 40
SMALLEST_PIVOT = 1e-13
TRIED = 8


@compiled
@no_type_check
def grow_items(
    gram, children, parent, area, level, correlations, sizes, sigmas, threshold, share, budget, condition_limit,
    leaves, counts, values, fates, requests, steps,
):  # fmt: skip
    """Grows every item until it is done or asks for children that are not known, in place.

    Trees grow to as many leaves as there is room for, and are then pruned to the budget.

    Args:
        gram: inner products of the columns of all known nodes, [slots, slots].
        children: the four quarters of every node; UNKNOWN or TEXEL where it has none, [slots, 4].
        parent: the node whose quarter each node is, -1 for roots, [slots].
        area: share of every node in the area of all texels, [slots].
        level: of every node, [slots].
        correlations: A'b of every node, [items, channels, slots].
        sizes: |b|, or 1 where it is 0, [items, channels].
        sigmas: noise of a sample, [items].
        threshold, share, budget, condition_limit: as `ProjectedGain` and `AdaptiveHaar` have them.
        leaves: nodes of the tree, [items, room]; the first counts[item] are in use.
        counts: number of leaves, [items].
        values: radiance on the leaves, [items, channels, room].
        fates: why each leaf is not divided, [items, room].
        requests: out: 1 where the children of a leaf must be known first, [items, room].
        steps: factorisations spent, added to, [items, channels].
    """
    room = leaves.shape[1]
    matrix = np.empty((room, room))
    factor = np.empty((room, room))
    across = np.empty((room, WAVELETS * room))
    for item in range(len(counts)):
        requests[item, :] = 0
        while True:
            count = counts[item]
            fit_channels(
                gram, matrix, factor, correlations[item], leaves[item], count, sizes[item], values[item], steps[item]
            )
            energy = leaf_energies(matrix, values[item], count)
            floor = ASKED_ENERGY * sigmas[item] ** 2
            candidates = candidate_leaves(
                gram, children, level, leaves[item], count, energy, floor, fates[item], requests[item]
            )
            if requests[item, :count].any():
                break
            gains, sound = candidate_gains(
                gram, children, area, matrix, factor, across, correlations[item], leaves[item], count, values[item],
                candidates, sigmas[item], condition_limit,
            )  # fmt: skip
            if not divide(
                children, leaves[item], counts, item, values[item], fates[item], candidates, gains, sound, threshold,
                share, room,
            ):  # fmt: skip
                prune(
                    gram, parent, matrix, factor, correlations[item], sizes[item], leaves[item], counts, item,
                    values[item], fates[item], steps[item], budget,
                )  # fmt: skip
                break


@compiled
@no_type_check
def fit_channels(gram, matrix, factor, correlations, leaves, count, sizes, values, steps):
    """Fits every channel on the leaves, from where it is; returns b'A v: the more, the smaller the residual."""
    gather(gram, leaves, count, matrix)
    explained = 0.0
    for channel in range(values.shape[0]):
        steps[channel] += fit_leaves(
            matrix, factor, correlations[channel], leaves, count, sizes[channel], values[channel]
        )
        for i in range(count):
            explained += correlations[channel, leaves[i]] * values[channel, i]
    return explained


@compiled
@no_type_check
def gather(gram, leaves, count, matrix):
    """Fills the Gram matrix of the leaves."""
    for i in range(count):
        row = gram[leaves[i]]
        for j in range(count):
            matrix[i, j] = row[leaves[j]]


@compiled
@no_type_check
def fit_leaves(matrix, factor, correlations, leaves, count, size, values):
    """Sets the radiance to the non-negative least squares answer on the leaves, from where it is; returns the steps."""
    linear = np.empty(count)
    norms = np.empty(count)
    for i in range(count):
        norms[i] = np.sqrt(max(matrix[i, i], 0.0))
        linear[i] = correlations[leaves[i]] / (norms[i] * size) if norms[i] > 0.0 else 0.0
    x = np.empty(count)
    for i in range(count):
        x[i] = values[i] * norms[i] / size
    spent = minimize_nonnegative(matrix, norms, linear, x, factor)
    for i in range(count):
        values[i] = x[i] * size / norms[i] if norms[i] > 0.0 else 0.0
    return spent


@compiled
@no_type_check
def minimize_nonnegative(matrix, norms, linear, x, factor):
    """Minimises x'Gx/2 - c'x over x >= 0, G with unit diagonal, from the support of x; returns the factorisations.

    Block principal pivoting (Portugal, Judice and Vicente 1994): all infeasible indices change sides while their
    number falls, the last one alone where it does not. Should that not end soon, Lawson and Hanson's method, which
    must, finishes.
    """
    count = len(x)
    passive = x > 0.0
    index = np.empty(count, np.int64)
    wrong = np.empty(count, np.bool_)
    fewest, chances = count + 1, CHANCES
    for step in range(PIVOTINGS):
        used = solve_passive(matrix, norms, linear, passive, index, x, factor)
        infeasible, last = 0, -1
        for i in range(count):
            if passive[i]:
                wrong[i] = x[i] < 0.0
            else:
                wrong[i] = norms[i] > 0.0 and slope(matrix, norms, linear, x, index, used, i) > TOLERANCE
            if wrong[i]:
                infeasible += 1
                last = i
        if infeasible == 0:
            return step + 1
        if infeasible < fewest:
            fewest, chances = infeasible, CHANCES
        else:
            chances -= 1
        for i in range(count):
            if wrong[i] and (chances >= 0 or i == last):
                passive[i] = not passive[i]
    for i in range(count):
        x[i] = max(x[i], 0.0)
    return PIVOTINGS + lawson_hanson(matrix, norms, linear, x, factor)


@compiled
@no_type_check
def lawson_hanson(matrix, norms, linear, x, factor):
    """Minimises as `minimize_nonnegative` does, one index in at a time; x >= 0 to begin from (Lawson, Hanson 1974).

    An index that rounding alone lets in leaves at once, without a step; it is not asked again before x has moved.
    """
    count = len(x)
    index = np.empty(count, np.int64)
    refused = np.zeros(count, np.bool_)
    passive = x > 0.0
    target = np.empty(count)
    spent, entrant = 0, -1
    while spent < 10 * count:
        moves, moved = walk(matrix, norms, linear, passive, index, x, target, factor)
        spent += moves
        if entrant >= 0 and not passive[entrant] and not moved:
            refused[entrant] = True
        else:
            refused[:] = False
        entrant = steepest(matrix, norms, linear, x, passive, index, refused)
        if entrant < 0:
            break
        passive[entrant] = True
    return spent


@compiled
@no_type_check
def walk(matrix, norms, linear, passive, index, x, target, factor):
    """Moves x to the minimiser over the passive indices, which leave where they meet 0 on the way.

    Returns the factorisations, and whether x moved before the last of them.
    """
    spent, moved = 0, False
    while True:
        solve_passive(matrix, norms, linear, passive, index, target, factor)
        spent += 1
        step, barrier = 1.0, -1
        for i in range(len(x)):
            if passive[i] and target[i] <= 0.0 and x[i] < step * (x[i] - target[i]):
                step = x[i] / (x[i] - target[i])
                barrier = i
        for i in range(len(x)):
            end = target[i] if barrier < 0 else x[i] + step * (target[i] - x[i])
            x[i] = max(end, 0.0) if passive[i] else 0.0
        if barrier < 0:
            return spent, moved
        moved = moved or step > 0.0
        x[barrier] = 0.0
        passive[barrier] = False


@compiled
@no_type_check
def steepest(matrix, norms, linear, x, passive, index, refused):
    """Returns the index outside that lowers the objective fastest, -1 where none does."""
    used = 0
    for i in range(len(x)):
        if passive[i]:
            index[used] = i
            used += 1
    best, entrant = TOLERANCE, -1
    for i in range(len(x)):
        if not passive[i] and not refused[i] and norms[i] > 0.0:
            w = slope(matrix, norms, linear, x, index, used, i)
            if w > best:
                best, entrant = w, i
    return entrant


@compiled
@no_type_check
def slope(matrix, norms, linear, x, index, used, i):
    """Returns w_i = (c - G x)_i for columns of length 1."""
    total = 0.0
    for a in range(used):
        j = index[a]
        total += matrix[i, j] / norms[j] * x[j]
    return linear[i] - total / norms[i]


@compiled
@no_type_check
def solve_passive(matrix, norms, linear, passive, index, x, factor):
    """Sets x to the minimiser over the passive indices, 0 elsewhere; returns how many there are."""
    used = 0
    for i in range(len(x)):
        x[i] = 0.0
        if passive[i]:
            index[used] = i
            used += 1
    factor_block(matrix, norms, index, used, factor)
    right = np.empty(used)
    for a in range(used):
        right[a] = linear[index[a]]
    for a in range(used):
        right[a] /= factor[a, a]
        for b in range(a + 1, used):
            right[b] -= factor[a, b] * right[a]
    for a in range(used - 1, -1, -1):
        total = right[a]
        for b in range(a + 1, used):
            total -= factor[a, b] * right[b]
        right[a] = total / factor[a, a]
        x[index[a]] = right[a]
    return used


@compiled
@no_type_check
def factor_block(matrix, norms, index, used, factor):
    """Factors the block U'U with the smallest ridge that makes it positive definite."""
    ridge = RIDGE
    while True:
        for a in range(used):
            i = index[a]
            for b in range(a, used):
                j = index[b]
                factor[a, b] = matrix[i, j] / (norms[i] * norms[j])
            factor[a, a] += ridge
        if cholesky(factor, used):
            return
        ridge *= 10.0


@compiled
@no_type_check
def cholesky(factor, used):
    """Replaces the upper triangle by its Cholesky factor U; returns whether it is positive definite."""
    weights = np.empty(used)
    for a in range(used):
        for b in range(a):
            weights[b] = factor[b, a]
        subtract_rows(weights, factor, a, a, used)
        if factor[a, a] <= SMALLEST_PIVOT:
            return False
        pivot = np.sqrt(factor[a, a])
        for b in range(a, used):
            factor[a, b] /= pivot
    return True


@compiled
@no_type_check
def subtract_rows(weights, rows, count, start, stop):
    """Subtracts from row `count` the weighted sum of the rows above it, four at a time, from column start to stop."""
    target = rows[count, start:stop]
    a = 0
    while a + 4 <= count:
        f0, f1, f2, f3 = weights[a], weights[a + 1], weights[a + 2], weights[a + 3]
        r0, r1, r2, r3 = rows[a, start:stop], rows[a + 1, start:stop], rows[a + 2, start:stop], rows[a + 3, start:stop]
        for q in range(len(target)):
            target[q] -= (f0 * r0[q] + f1 * r1[q]) + (f2 * r2[q] + f3 * r3[q])
        a += 4
    while a < count:
        f0, r0 = weights[a], rows[a, start:stop]
        for q in range(len(target)):
            target[q] -= f0 * r0[q]
        a += 1


@compiled
@no_type_check
def leaf_energies(matrix, values, count):
    """Returns the largest (v_k |a_k|)^2 over the channels: what each leaf alone puts into the photograph."""
    energy = np.zeros(count)
    for channel in range(values.shape[0]):
        for i in range(count):
            energy[i] = max(energy[i], values[channel, i] ** 2 * matrix[i, i])
    return energy


@compiled
@no_type_check
def candidate_leaves(gram, children, level, leaves, count, energy, floor, fates, requests):
    """Returns the leaves that may be divided; sets the fate of the others and asks for children not known."""
    candidates = np.empty(count, np.int64)
    found = 0
    for i in range(count):
        node = leaves[i]
        if children[node, 0] == TEXEL:
            fates[i] = RESOLVED
        elif gram[node, node] == 0.0:
            fates[i] = UNSEEN
        elif level[node] >= ALWAYS_ASKED and energy[i] < floor:
            fates[i] = BELOW_THRESHOLD
        elif children[node, 0] == UNKNOWN:
            requests[i] = 1
        else:
            candidates[found] = i
            found += 1
    return candidates[:found]


@compiled
@no_type_check
def candidate_gains(
    gram, children, area, matrix, factor, across, correlations, leaves, count, values, candidates, sigma,
    condition_limit,
):  # fmt: skip
    """Returns each candidate's gain in squared sigmas, summed over the channels, and whether any determines it."""
    gains = np.zeros(len(candidates))
    sound = np.zeros(len(candidates), np.bool_)
    norms = np.empty(count)
    for i in range(count):
        norms[i] = np.sqrt(max(matrix[i, i], 0.0))
    index = np.empty(count, np.int64)
    residual = np.empty((len(candidates), 4))
    innovation = np.empty((WAVELETS, WAVELETS))
    slopes = np.empty(WAVELETS)
    for channel in range(values.shape[0]):
        used, mean = 0, 0.0
        for i in range(count):
            if values[channel, i] > 0.0:
                index[used] = i
                used += 1
                mean += values[channel, i] * area[leaves[i]]
        if used == 0:
            sound[:] = True
            continue
        factor_block(matrix, norms, index, used, factor)
        project_trios(
            gram, children, factor, across, correlations[channel], leaves, index, used, norms, values[channel],
            candidates, residual,
        )  # fmt: skip
        for k in range(len(candidates)):
            node = leaves[candidates[k]]
            here = values[channel, candidates[k]]
            energy = trio(gram, children[node], across, used, k, residual[k], innovation, slopes)
            least = max((sigma / (condition_limit * (mean + here))) ** 2, FLOOR * energy)
            if positive_definite(innovation, least):
                sound[k] = True
                prior = (sigma / max(here, LEAST_PRIOR * mean)) ** 2
                reach = REACH * max(here, LEAST_REACH * mean)
                gains[k] += clipped_gain(innovation, slopes, prior, reach) / sigma**2
    return gains, sound


@compiled
@no_type_check
def project_trios(
    gram, children, factor, across, correlations, leaves, index, used, norms, values, candidates, residual
):
    """Fills U'^-1 P'W for the trios of all candidates, and A'(b - A v) of their quarters."""
    width = WAVELETS * len(candidates)
    for k in range(len(candidates)):
        for q in range(4):
            residual[k, q] = correlations[children[leaves[candidates[k]], q]]
    for a in range(used):
        row = gram[leaves[index[a]]]
        inverse, value = 1.0 / norms[index[a]], values[index[a]]
        target = across[a]
        for k in range(len(candidates)):
            quarters = children[leaves[candidates[k]]]
            first, second, third, fourth = row[quarters[0]], row[quarters[1]], row[quarters[2]], row[quarters[3]]
            residual[k, 0] -= value * first
            residual[k, 1] -= value * second
            residual[k, 2] -= value * third
            residual[k, 3] -= value * fourth
            target[3 * k] = (first - second + third - fourth) * inverse
            target[3 * k + 1] = (first + second - third - fourth) * inverse
            target[3 * k + 2] = (first - second - third + fourth) * inverse
    weights = np.empty(used)
    for a in range(used):
        for b in range(a):
            weights[b] = factor[b, a]
        subtract_rows(weights, across, a, 0, width)
        inverse = 1.0 / factor[a, a]
        for q in range(width):
            across[a, q] *= inverse


@compiled
@no_type_check
def trio(gram, quarters, across, used, k, residual, innovation, slopes):
    """Fills S = W'W - W'P (P'P)^-1 P'W and W'(b - A v) of one trio; returns its largest |A psi|^2."""
    energy = 0.0
    for u in range(WAVELETS):
        slopes[u] = 0.0
        for q in range(4):
            slopes[u] += sign(u, q) * residual[q]
        for w in range(u + 1):
            total = 0.0
            for q in range(4):
                row = gram[quarters[q]]
                for p in range(4):
                    total += sign(u, q) * sign(w, p) * row[quarters[p]]
            if u == w:
                energy = max(energy, total)
            for a in range(used):
                total -= across[a, 3 * k + u] * across[a, 3 * k + w]
            innovation[u, w] = total
            innovation[w, u] = total
    return energy


@compiled
@no_type_check
def sign(wavelet, quarter):
    """Returns the value of the horizontal, vertical or diagonal wavelet on a quarter of its support."""
    right, low = quarter % 2, quarter // 2
    return 1.0 - 2.0 * (right if wavelet == 0 else low if wavelet == 1 else (right + low) % 2)


@compiled
@no_type_check
def positive_definite(symmetric, shift):
    """Returns whether all eigenvalues of a 3 x 3 matrix exceed the shift: S - shift 1 has a Cholesky factor."""
    a, b, c = symmetric[0, 0] - shift, symmetric[1, 0], symmetric[2, 0]
    if a <= 0.0:
        return False
    d = symmetric[1, 1] - shift - b * b / a
    if d <= 0.0:
        return False
    e = symmetric[2, 1] - b * c / a
    return symmetric[2, 2] - shift - c * c / a - e * e / d > 0.0


@compiled
@no_type_check
def clipped_gain(innovation, slopes, prior, reach):
    """Returns (2 s - s^2) g'y with y = (S + prior 1)^-1 g and the step s that keeps |y| within reach."""
    a = innovation[0, 0] + prior
    b, c = innovation[1, 0] / a, innovation[2, 0] / a
    d = innovation[1, 1] + prior - b * b * a
    e = (innovation[2, 1] - b * c * a) / d
    f = innovation[2, 2] + prior - c * c * a - e * e * d
    second = slopes[1] - b * slopes[0]
    third = (slopes[2] - c * slopes[0] - e * second) / f
    second = second / d - e * third
    first = slopes[0] / a - b * second - c * third
    largest = max(abs(first), abs(second), abs(third))
    step = reach / largest if largest > reach else 1.0
    return (2.0 * step - step * step) * (slopes[0] * first + slopes[1] * second + slopes[2] * third)


@compiled
@no_type_check
def divide(children, leaves, counts, item, values, fates, candidates, gains, sound, threshold, share, room):
    """Divides the leaves of largest gain, sets the fate of the other candidates; returns whether any was divided."""
    functions = counts[item]
    worthy = 0
    for k in range(len(candidates)):
        open_one = sound[k] and gains[k] > threshold
        fates[candidates[k]] = LIMIT if open_one else BELOW_THRESHOLD if sound[k] else ILL_CONDITIONED
        if open_one:
            worthy += 1
        else:
            gains[k] = -1.0
    count = min(max(1, int(share * functions / WAVELETS)), (room - functions) // WAVELETS, worthy)
    order = np.argsort(-gains, kind="mergesort")
    for k in order[:count]:
        place = candidates[k]
        node = leaves[place]
        for q in range(4):
            spot = place if q == 0 else counts[item]
            if q > 0:
                counts[item] += 1
            leaves[spot] = children[node, q]
            for channel in range(values.shape[0]):
                values[channel, spot] = values[channel, place]
    return count > 0


@compiled
@no_type_check
def prune(gram, parent, matrix, factor, correlations, sizes, leaves, counts, item, values, fates, steps, budget):
    """Joins quarters, those that explain least when all is fitted anew, until the budget holds."""
    while counts[item] > budget:
        count = counts[item]
        order = np.argsort(parent[leaves[:count]], kind="mergesort")
        quads = whole_quads(parent, leaves, order)
        gather(gram, leaves, count, matrix)
        losses = np.zeros(len(quads))
        joined = np.empty((len(quads), values.shape[0]))
        for channel in range(values.shape[0]):
            slopes = residual_slopes(matrix, correlations[channel], leaves, count, values[channel])
            for k in range(len(quads)):
                places = order[quads[k] : quads[k] + 4]
                loss, joined[k, channel] = joining(matrix, slopes, values[channel], places)
                losses[k] += loss
        ranked = np.argsort(losses, kind="mergesort")
        ranked = ranked[:TRIED]
        best = best_of(
            gram,
            parent,
            matrix,
            factor,
            correlations,
            sizes,
            leaves,
            count,
            values,
            steps,
            order,
            quads,
            joined,
            ranked,
        )
        ranked = ranked[best : best + 1]
        counts[item] = join(parent, leaves, count, values, fates, order, quads, joined, ranked)
        fit_channels(gram, matrix, factor, correlations, leaves, counts[item], sizes, values, steps)


@compiled
@no_type_check
def whole_quads(parent, leaves, order):
    """Returns where in the order by parents four quarters of one node stand together."""
    found = np.empty(len(order) // 4 + 1, np.int64)
    count, k = 0, 0
    while k + 3 < len(order):
        above = parent[leaves[order[k]]]
        if above >= 0 and parent[leaves[order[k + 3]]] == above:
            found[count] = k
            count += 1
            k += 4
        else:
            k += 1
    return found[:count]


@compiled
@no_type_check
def residual_slopes(matrix, correlations, leaves, count, values):
    """Returns A'(b - A v) of every leaf."""
    slopes = np.empty(count)
    for i in range(count):
        slopes[i] = correlations[leaves[i]]
        for j in range(count):
            slopes[i] -= matrix[i, j] * values[j]
    return slopes


@compiled
@no_type_check
def joining(matrix, slopes, values, places):
    """Returns what it costs that four leaves share one radiance t >= 0, all others as they are, and t."""
    curvature, slope = 0.0, 0.0
    for i in places:
        slope += slopes[i]
        for j in places:
            curvature += matrix[i, j]
            slope += matrix[i, j] * values[j]
    t = max(slope / curvature, 0.0) if curvature > 0.0 else 0.0
    loss = 0.0
    for i in places:
        step = t - values[i]
        loss -= 2.0 * slopes[i] * step
        for j in places:
            loss += step * matrix[i, j] * (t - values[j])
    return loss, t


@compiled
@no_type_check
def best_of(
    gram, parent, matrix, factor, correlations, sizes, leaves, count, values, steps, order, quads, joined, ranked
):
    """Returns which of some quads costs least when it is joined and all leaves are fitted anew."""
    best, most = 0, -np.inf
    fates = np.empty(len(leaves), np.int64)
    for k in range(len(ranked)):
        trial, radiance = leaves.copy(), values.copy()
        left = join(parent, trial, count, radiance, fates, order, quads, joined, ranked[k : k + 1])
        explained = fit_channels(gram, matrix, factor, correlations, trial, left, sizes, radiance, steps)
        if explained > most:
            best, most = k, explained
    return best


@compiled
@no_type_check
def join(parent, leaves, count, values, fates, order, quads, joined, chosen):
    """Replaces quarters by the node they make up, in place; returns how many leaves are left."""
    dropped = np.zeros(count, np.bool_)
    for k in chosen:
        first = order[quads[k]]
        leaves[first] = parent[leaves[first]]
        fates[first] = LIMIT
        for channel in range(values.shape[0]):
            values[channel, first] = joined[k, channel]
        for q in range(1, 4):
            dropped[order[quads[k] + q]] = True
    left = 0
    for i in range(count):
        if not dropped[i]:
            leaves[left], fates[left] = leaves[i], fates[i]
            for channel in range(values.shape[0]):
                values[channel, left] = values[channel, i]
            left += 1
    return left
