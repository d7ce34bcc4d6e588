use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::elastic::{ElasticForces, GRAIN};

/// Most iterations of conjugate gradients in one step.
const ITERATIONS: usize = 40;

/// Relative residual at which the iterations end.
const RESIDUAL: f64 = 1e-2;

/// Forces on single vertices besides the elastic ones.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PointForce {
    /// Force, newtons.
    pub force: DVec3,
    /// Derivative of the negative force by the position, N/m.
    pub stiffness: f64,
    /// Derivative of the negative force by the velocity, N·s/m.
    pub drag: DMat3,
}

/// The linearly implicit Euler step of Baraff and Witkin (1998): conjugate gradients on
/// `(M + dt D + dt² K) Δv = dt (f − D v − dt K v)`, with 3 × 3 blocks of the diagonal as
/// preconditioner.
///
/// The right side vanishes in equilibrium, so that cloth at rest does not depend on the step or on the
/// number of iterations.
#[derive(Debug, Clone)]
pub(super) struct ImplicitStep {
    /// Rows of the matrix: starts, columns, blocks.
    starts: Vec<usize>,
    stencils: Vec<Vec<u32>>,
    blocks: Vec<DMat3>,
}

impl ImplicitStep {
    pub(super) fn new(elastic: &ElasticForces) -> Self {
        let stencils = elastic.stencils();
        let mut starts = vec![0];
        for stencil in &stencils {
            starts.push(starts[starts.len() - 1] + stencil.len());
        }
        let blocks = vec![DMat3::ZERO; starts[starts.len() - 1]];
        Self { starts, stencils, blocks }
    }

    /// Changes of the velocities, m/s, in a step of `dt` seconds from the state in which `elastic` is
    /// linearised. Vertices with the inverse mass 0 do not move. `damping`, seconds, is the damping
    /// relative to the stiffness.
    pub(super) fn solve(
        &mut self,
        elastic: &ElasticForces,
        (inverse_masses, velocities): (&[f64], &[DVec3]),
        points: &[PointForce],
        (dt, damping): (f64, f64),
    ) -> Vec<DVec3> {
        let lag = dt * (dt + damping);
        self.assemble(elastic);
        let free = |v: usize| inverse_masses[v] > 0.0;
        let right: Vec<DVec3> = (0..velocities.len())
            .into_par_iter()
            .with_min_len(GRAIN)
            .map(|v| {
                if !free(v) {
                    return DVec3::ZERO;
                }
                let point = &points[v];
                let pull = elastic.force(v) + point.force - point.drag * velocities[v];
                let stiff = self.row(v, velocities);
                pull * dt - stiff * lag - velocities[v] * (dt * dt * point.stiffness)
            })
            .collect();
        // The matrix of the step replaces the stiffness.
        let (starts, stencils) = (&self.starts, &self.stencils);
        let mut rows: Vec<&mut [DMat3]> = Vec::with_capacity(stencils.len());
        let mut rest = &mut self.blocks[..];
        for stencil in stencils {
            let (row, others) = rest.split_at_mut(stencil.len());
            rows.push(row);
            rest = others;
        }
        debug_assert_eq!(starts.len(), rows.len() + 1);
        let inverse: Vec<DMat3> = rows
            .par_iter_mut()
            .enumerate()
            .with_min_len(GRAIN)
            .map(|(v, row)| {
                let own = stencils[v].binary_search(&(v as u32)).unwrap_or(0);
                for (block, &column) in row.iter_mut().zip(&stencils[v]) {
                    *block = if free(column as usize) { *block * lag } else { DMat3::ZERO };
                }
                if !free(v) {
                    return DMat3::ZERO;
                }
                let point = &points[v];
                let mass = 1.0 / inverse_masses[v] + dt * dt * point.stiffness;
                row[own] += DMat3::from_diagonal(DVec3::splat(mass)) + point.drag * dt;
                row[own].inverse()
            })
            .collect();
        self.conjugate_gradients(&right, &inverse)
    }

    fn assemble(&mut self, elastic: &ElasticForces) {
        let mut rows: Vec<&mut [DMat3]> = Vec::with_capacity(self.stencils.len());
        let mut rest = &mut self.blocks[..];
        for stencil in &self.stencils {
            let (row, others) = rest.split_at_mut(stencil.len());
            rows.push(row);
            rest = others;
        }
        rows.par_iter_mut().zip(&self.stencils).enumerate().with_min_len(GRAIN).for_each(
            |(v, (row, stencil))| {
                row.fill(DMat3::ZERO);
                elastic.add_stiffness(v, stencil, row);
            },
        );
    }

    /// A row of the matrix times a vector.
    fn row(&self, v: usize, x: &[DVec3]) -> DVec3 {
        let blocks = &self.blocks[self.starts[v]..self.starts[v + 1]];
        let products = blocks.iter().zip(&self.stencils[v]);
        products.fold(DVec3::ZERO, |sum, (&block, &column)| sum + block * x[column as usize])
    }

    fn conjugate_gradients(&self, right: &[DVec3], inverse: &[DMat3]) -> Vec<DVec3> {
        let count = right.len();
        let mut solution = vec![DVec3::ZERO; count];
        let mut residual = right.to_vec();
        let mut better: Vec<DVec3> = residual.iter().zip(inverse).map(|(&r, &m)| m * r).collect();
        let mut direction = better.clone();
        let mut energy = dot(&residual, &better);
        let enough = energy * RESIDUAL * RESIDUAL;
        let mut image = vec![DVec3::ZERO; count];
        for _ in 0..ITERATIONS {
            if energy <= enough || energy <= f64::MIN_POSITIVE {
                break;
            }
            image.par_iter_mut().enumerate().with_min_len(GRAIN).for_each(|(v, image)| {
                // Rows of fixed vertices have an inverse of zero.
                *image =
                    if inverse[v] == DMat3::ZERO { DVec3::ZERO } else { self.row(v, &direction) };
            });
            let curvature = dot(&direction, &image);
            if curvature <= 0.0 {
                break;
            }
            let step = energy / curvature;
            for v in 0..count {
                solution[v] += direction[v] * step;
                residual[v] -= image[v] * step;
                better[v] = inverse[v] * residual[v];
            }
            let next = dot(&residual, &better);
            let ratio = next / energy;
            energy = next;
            for (direction, &better) in direction.iter_mut().zip(&better) {
                *direction = better + *direction * ratio;
            }
        }
        solution
    }
}

/// Scalar product, summed in order.
fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}
