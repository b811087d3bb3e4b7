"""The certified global minimum of subspace fitting: a point, and a proof that no other configuration lies lower.

The lemma: if J(x) <= f* < 1, every source of x lies where D(θ) = 1 − ‖Uᴴâ(θ)‖² <= f*. The 2K-dimensional search thus
becomes one over a single source. The modules follow the proof, which the documentation gives in full:

    chart            coordinates of one source, phases of the response and bounds of their derivatives
    phases           compiled derivatives of the phases
    cells            T2: how far a response turns on a path, for each cell of the box of one source
    kernels, regions T3: what is left of the box where D may be at most f*, as regions of small boxes
    balls            bounds of the derivatives of a response on a ball around a source
    couplings        bounds of the inner products of responses of different regions
    minimum          T5, T6: J has one minimum in the product of the regions
    certify          the algorithm, with T4: no region holds two sources
    one_source       T7: the minimum of RLS, to a stated gap
"""

from .certify import STEPS, Certificate, certify, unproven, warm_up
from .one_source import OneSource, certify_one_source

__all__ = ["STEPS", "Certificate", "OneSource", "certify", "certify_one_source", "unproven", "warm_up"]
