"""Slow, plain twins of the compiled kernels. They share no code with them."""

from itertools import combinations

import numpy as np


def two_best(S):
    """Most similar column of each row, with the two highest similarities."""
    nearest, best, second = [], [], []
    for row in S:
        order = sorted(range(len(row)), key=lambda j: (-row[j], j))
        nearest.append(order[0])
        best.append(row[order[0]])
        second.append(row[order[1]] if len(order) > 1 else -1.0)
    return nearest, best, second


def average_linkage(descriptors, min_similarity):
    """Merge the two closest clusters until the closest are too far apart; clusters as sorted tuples."""
    d = 1 - descriptors.astype(np.float64) @ descriptors.T.astype(np.float64)
    clusters = [(i,) for i in range(len(descriptors))]
    while len(clusters) > 1:
        a, b = min(combinations(clusters, 2), key=lambda ab: np.mean([d[i, j] for i in ab[0] for j in ab[1]]))
        if np.mean([d[i, j] for i in a for j in b]) > 1 - min_similarity:
            break
        clusters = [c for c in clusters if c not in (a, b)] + [tuple(sorted(a + b))]
    return sorted(clusters)


def neighbour_rules(xy, scale, label, k1, k2, k3):
    """For each feature, {neighbour: set of rules}."""
    out = []
    for i in range(len(xy)):
        distance = np.hypot(*(xy - xy[i]).T)
        others = sorted((j for j in range(len(xy)) if distance[j] > 1e-6), key=lambda j: (distance[j], j))
        rules = {}
        for j in others[:k1]:
            rules.setdefault(j, set()).add("nearest")
        for j in others:
            if distance[j] <= k2 * scale[i]:
                rules.setdefault(j, set()).add("within")
        for j in [j for j in others if label[j] == label[i]][:k3]:
            rules.setdefault(j, set()).add("cluster")
        out.append(rules)
    return out


def two_keypoint_matches(X, rules1, rules2):
    """Return the set of (p1, n1, p2, n2) whose neighbours agree in a rule and whose matches are in X."""
    X = set(X)
    found = set()
    for p1, p2 in X:
        for n1, how1 in rules1[p1].items():
            for n2, how2 in rules2[p2].items():
                if (n1, n2) in X and how1 & how2:
                    found.add((p1, n1, p2, n2))
    return found


def two_keypoint_descriptor(p1, n1, p2, n2, angles, scales):
    """Return dist_r, angle_d and min_d of the paper."""
    d1 = np.linalg.norm(n1 - p1) / scales[0]
    d2 = np.linalg.norm(n2 - p2) / scales[1]
    t1 = np.degrees(np.arctan2(*(n1 - p1)[::-1])) - angles[0]
    t2 = np.degrees(np.arctan2(*(n2 - p2)[::-1])) - angles[1]
    turn = (t1 - t2) % 360
    return min(d1 / d2, d2 / d1), np.radians(min(turn, 360 - turn)), min(d1, d2)


def eight_point(x1, x2, weights=None):
    """Normalised eight-point algorithm, by the singular value decomposition of the equations themselves."""
    w = np.ones(len(x1)) if weights is None else weights

    def condition(x):
        c = np.average(x, axis=0, weights=w)
        s = np.sqrt(2) / np.sqrt(np.average(((x - c) ** 2).sum(axis=1), weights=w))
        return np.array([[s, 0, -s * c[0]], [0, s, -s * c[1]], [0, 0, 1]])

    T1, T2 = condition(x1), condition(x2)
    h1 = np.column_stack([x1, np.ones(len(x1))]) @ T1.T
    h2 = np.column_stack([x2, np.ones(len(x2))]) @ T2.T
    A = np.array([np.sqrt(v) * np.outer(b, a).ravel() for a, b, v in zip(h1, h2, w, strict=True)])
    F = np.linalg.svd(A)[2][-1].reshape(3, 3)
    U, s, Vt = np.linalg.svd(F)
    F = T2.T @ U @ np.diag([s[0], s[1], 0]) @ Vt @ T1
    return F / np.linalg.norm(F)


def sampson(F, a, b):
    a, b = np.append(a, 1), np.append(b, 1)
    l2, l1 = F @ a, F.T @ b
    return abs(b @ l2) / np.sqrt(l2[0] ** 2 + l2[1] ** 2 + l1[0] ** 2 + l1[1] ** 2)


def votes(F, x1, x2, threshold):
    return [sum(sampson(f, a, b) < threshold for f in F) for a, b in zip(x1, x2, strict=True)]


def one_to_one(feature1, feature2):
    """Walk down the ranking, skip a match whose feature is used already."""
    used1, used2, keep = set(), set(), []
    for a, b in zip(feature1, feature2, strict=True):
        ok = a not in used1 and b not in used2
        keep.append(ok)
        if ok:
            used1.add(a)
            used2.add(b)
    return keep


def coherence(x1, x2, scale1, scale2, location1, weights, roll, near, far):
    """Sum and share of what the nearest asked locations say for each match, near and far."""
    asked = [m for m in range(len(x1)) if weights[m] >= 0.02]
    places = sorted({location1[m] for m in asked})
    members = {p: [m for m in asked if location1[m] == p] for p in places}
    turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    out = []
    for m in range(len(x1)):
        distance = {p: np.hypot(*(x1[members[p][0]] - x1[m])) for p in places}
        order = sorted(places, key=lambda p: (distance[p], p))
        row = []
        for count in (near, far):
            agreement = most = 0.0
            for p in order[: count + 1]:
                if not 2.0 <= distance[p] <= 300.0:
                    continue
                said = [0.0]
                for n in members[p]:
                    v = x1[n] - x1[m]
                    s = np.sqrt(scale2[m] / scale1[m] * scale2[n] / scale1[n])
                    e = np.hypot(*(x2[n] - x2[m] - s * turn @ v)) / (s * np.hypot(*v))
                    said.append(weights[n] * (1 - (e / 0.4) ** 2))
                agreement += max(said)
                most += max(weights[n] for n in members[p])
            row += [agreement, agreement / (most + 0.5)]
        out.append(row)
    return np.array(out)
