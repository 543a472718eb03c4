"""First variations by hand: exact gradients of energies on an exact surface, point by point."""

import jax
import jax.numpy as jnp

from jaxwillmore.surface import AbstractLevelSet


class Exact:
    """Differential geometry of the level sets of one function, by automatic differentiation.

    Everything is a function of one point of space and belongs to the level set through it.
    """

    def __init__(self, surface: AbstractLevelSet):
        self.surface = surface

    def normal(self, p):
        return self.surface.normal(p[None])[0]

    def A(self, p):
        return self.surface.weingarten(p[None])[0]

    def H(self, p):
        return jnp.trace(self.A(p))

    def A2(self, p):
        return jnp.sum(self.A(p) ** 2)

    def K(self, p):
        return 0.5 * (self.H(p) ** 2 - self.A2(p))

    def tangential(self, p, vector):
        nu = self.normal(p)
        return vector - jnp.dot(vector, nu) * nu

    def gradient(self, f):
        return lambda p: self.tangential(p, jax.grad(f)(p))

    def divergence(self, W):
        """Of a tangential field: the trace of its derivative in the tangent plane."""

        def at(p):
            D, nu = jax.jacfwd(W)(p), self.normal(p)
            return jnp.trace(D) - nu @ D @ nu

        return at

    def laplacian(self, f):
        return self.divergence(self.gradient(f))

    def gauss_operator(self, f):
        """∇·((HI − A)∇f)."""
        gradient = self.gradient(f)

        def flux(p):
            A, g = self.A(p), gradient(p)
            return jnp.trace(A) * g - A @ g

        return self.divergence(flux)

    # δE = ∫ G V for x ↦ x + Vν with fields that stay on their points.

    def of_curvature(self, f, f_H):
        """G of ∫ f with f depending on H and on carried fields: −Δf_H − |A|²f_H + fH."""
        laplacian = self.laplacian(f_H)
        return lambda p: -laplacian(p) - self.A2(p) * f_H(p) + f(p) * self.H(p)

    def of_gaussian_curvature(self, f, f_K):
        """G of ∫ f with f depending on K: (f − K f_K)H − ∇·((HI − A)∇f_K)."""
        operator = self.gauss_operator(f_K)
        return lambda p: (f(p) - self.K(p) * f_K(p)) * self.H(p) - operator(p)

    def of_position_and_normal(self, f):
        """G of ∫ f(x, ν): fH + ∂f/∂x·ν + ∇·(P ∂f/∂ν)."""

        def flux(p):
            return self.tangential(p, jax.grad(f, argnums=1)(p, self.normal(p)))

        divergence = self.divergence(flux)

        def at(p):
            nu = self.normal(p)
            pull = jnp.dot(jax.grad(f)(p, nu), nu)
            return f(p, nu) * self.H(p) + pull + divergence(p)

        return at

    def of_gradient(self, c):
        """G of ∫ ½|∇c|² with a carried c: ½|∇c|²H − ∇c·A∇c."""
        gradient = self.gradient(c)

        def at(p):
            g = gradient(p)
            return 0.5 * jnp.dot(g, g) * self.H(p) - g @ self.A(p) @ g

        return at

    # A membrane of two phases, b = 2b_b; all moduli are functions of c, and c is one of the place.

    def chemical_potential(self, c, b_b, H0, b_k, Psi, gamma):
        """μ = Ψ' − γΔc + ½b'e² − b e H₀' + b_k'K with e = H − H₀."""
        laplacian = self.laplacian(c)

        def at(p):
            u, e = c(p), self.H(p) - H0(c(p))
            db_b, dH0, db_k, dPsi = (jax.grad(f)(u) for f in (b_b, H0, b_k, Psi))
            bending = db_b * e**2 - 2 * b_b(u) * e * dH0 + db_k * self.K(p)
            return dPsi - gamma * laplacian(p) + bending

        return at

    def two_phase_force(self, c, b_b, H0, b_k, Psi, gamma):
        """V_c = ΔU + |A|²U − ½bHe² + ∇·((HI−A)∇b_k) − (Ψ + ½γ|∇c|²)H + γ∇c·A∇c, U = b e."""
        gradient = self.gradient(c)

        def U(p):
            return 2 * b_b(c(p)) * (self.H(p) - H0(c(p)))

        laplacian = self.laplacian(U)
        gauss = self.gauss_operator(lambda p: b_k(c(p)))

        def at(p):
            H, A, e, g = self.H(p), self.A(p), self.H(p) - H0(c(p)), gradient(p)
            bending = laplacian(p) + self.A2(p) * U(p) - b_b(c(p)) * H * e**2 + gauss(p)
            line = -(Psi(c(p)) + 0.5 * gamma * jnp.dot(g, g)) * H + gamma * g @ A @ g
            return bending + line

        return at
