use glam::{DMat3, DVec3, Mat3, Vec3};
use rayon::prelude::*;

use super::elastic::{Contribution, ElasticForces, GRAIN};

/// Most iterations of conjugate gradients in one step.
const ITERATIONS: usize = 40;

/// Relative residual at which the iterations end.
const RESIDUAL: f64 = 1e-2;

/// Rows of the matrix within which the preconditioner couples; the same for any number of threads.
const CHUNK: usize = 512;

/// Forces on single vertices besides the elastic ones.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PointForce {
    /// Force, newtons.
    pub force: DVec3,
    /// Derivative of the negative force by the position, N/m.
    pub stiffness: f64,
    /// Derivative of the negative force by the velocity, N·s/m.
    pub drag: DMat3,
    /// Drag times the velocity of what drags, newtons.
    pub drive: DVec3,
    /// Direction in which the velocity is known, and the speed along it, m/s.
    pub held: Option<(DVec3, f64)>,
}

/// The linearly implicit Euler step of Baraff and Witkin (1998): conjugate gradients on
/// `(M + dt D + dt² K) Δv = dt (f − D v − dt K v)`.
///
/// The preconditioner is the symmetric Gauss–Seidel method within chunks of rows, in the form of
/// Eisenstat (1981), which needs no more products than the matrix alone. The right side vanishes in
/// equilibrium, so that cloth at rest does not depend on the step, on the number of iterations or on
/// the single precision of the matrix.
#[derive(Debug, Clone)]
pub(super) struct ImplicitStep {
    rows: Vec<Row>,
    /// Columns of the blocks of each row.
    columns: Vec<u32>,
    blocks: Vec<Mat3>,
    contributions: Vec<Contribution>,
    /// Inverses of the blocks of the diagonal.
    inverse: Vec<Mat3>,
}

/// A row of the upper triangle: the block of the diagonal, then those of later columns in its chunk,
/// then those in other chunks.
#[derive(Debug, Clone, Copy, Default)]
struct Row {
    start: usize,
    /// First block of another chunk.
    outer: usize,
    end: usize,
    /// Contributions of elements to the row.
    contributions: [usize; 2],
}

impl ImplicitStep {
    pub(super) fn new(elastic: &ElasticForces) -> Self {
        let mut made = Self {
            rows: Vec::new(),
            columns: Vec::new(),
            blocks: Vec::new(),
            contributions: Vec::new(),
            inverse: Vec::new(),
        };
        for (v, stencil) in elastic.stencils().into_iter().enumerate() {
            let chunk = v / CHUNK;
            let start = made.columns.len();
            let inner = |&column: &u32| column as usize / CHUNK == chunk;
            made.columns.push(v as u32);
            made.columns.extend(stencil.iter().filter(|c| inner(c) && **c as usize > v));
            let outer = made.columns.len();
            made.columns.extend(stencil.iter().filter(|c| !inner(c)));
            let end = made.columns.len();
            let first = made.contributions.len();
            made.contributions.extend(elastic.contributions(v, &made.columns[start..end]));
            let contributions = [first, made.contributions.len()];
            made.rows.push(Row { start, outer, end, contributions });
        }
        made.blocks = vec![Mat3::ZERO; made.columns.len()];
        made.inverse = vec![Mat3::ZERO; made.rows.len()];
        made
    }

    /// Changes of the velocities, m/s, in a step of `dt` seconds from the state in which `elastic` is
    /// linearised for that step. Vertices with the inverse mass 0 do not move.
    pub(super) fn solve(
        &mut self,
        elastic: &ElasticForces,
        (inverse_masses, velocities): (&[f64], &[DVec3]),
        points: &[PointForce],
        dt: f64,
    ) -> Vec<DVec3> {
        let right: Vec<Vec3> = (0..velocities.len())
            .into_par_iter()
            .with_min_len(GRAIN)
            .map(|v| {
                if inverse_masses[v] == 0.0 {
                    return Vec3::ZERO;
                }
                let (point, velocity) = (&points[v], velocities[v]);
                let pull = point.force + point.drive
                    - point.drag * velocity
                    - velocity * (dt * point.stiffness);
                (elastic.impulse(v) + pull * dt).as_vec3()
            })
            .collect();
        self.assemble(elastic, inverse_masses, points, dt);
        let guesses: Vec<[Vec3; 2]> = inverse_masses
            .iter()
            .zip(points)
            .zip(velocities)
            .map(|((&inverse_mass, point), &velocity)| {
                let given = 1.0 + dt * dt * point.stiffness * inverse_mass;
                let fall = point.force * (dt * inverse_mass / given);
                let held = point.held.filter(|_| inverse_mass > 0.0);
                [fall, DVec3::ZERO].map(|change| {
                    let stop = held.map_or(DVec3::ZERO, |(along, speed)| {
                        along * (speed - (velocity + change).dot(along))
                    });
                    (change + stop).as_vec3()
                })
            })
            .collect();
        // Free fall under the forces on single vertices, which a sheet without contacts follows exactly, or
        // rest, from which cloth on a body hardly moves.
        let [falling, resting] = [0, 1].map(|which| {
            let guess: Vec<Vec3> = guesses.iter().map(|guess| guess[which]).collect();
            let image = self.product(&guess);
            let rest: Vec<Vec3> =
                right.iter().zip(image).map(|(&right, image)| right - image).collect();
            (self.energy(&rest), rest, guess)
        });
        let (_, rest, guess) = if falling.0 <= resting.0 { falling } else { resting };
        let free = |(right, point): (&Vec3, &PointForce)| {
            let along = point.held.map_or(Vec3::ZERO, |held| held.0.as_vec3());
            *right - along * right.dot(along)
        };
        let reference: Vec<Vec3> = right.iter().zip(points).map(free).collect();
        let enough = RESIDUAL * RESIDUAL * self.energy(&reference);
        let found = self.conjugate_gradients(&rest, enough);
        found.into_iter().zip(guess).map(|(x, guess)| (x + guess).as_dvec3()).collect()
    }

    /// The matrix times `x`.
    fn product(&self, x: &[Vec3]) -> Vec<Vec3> {
        let mut image = vec![Vec3::ZERO; x.len()];
        image.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, image)| {
            let base = chunk * CHUNK;
            for index in 0..image.len() {
                let Row { start, outer, end, .. } = self.rows[base + index];
                image[index] += self
                    .part(start, end)
                    .fold(Vec3::ZERO, |sum, (block, column)| sum + *block * x[column]);
                // The lower triangle within the chunk.
                for (block, column) in self.part(start + 1, outer) {
                    image[column - base] += block.mul_transpose_vec3(x[base + index]);
                }
            }
        });
        image
    }

    /// Energy `bᵀ (D + L)⁻ᵀ D (D + L)⁻¹ b` of a right side, which measures residuals.
    fn energy(&self, right: &[Vec3]) -> f64 {
        let mut residual = right.to_vec();
        in_order(residual.par_chunks_mut(CHUNK).enumerate().map(|(chunk, residual)| {
            self.solve_lower(chunk, residual);
            let base = chunk * CHUNK;
            residual
                .iter()
                .enumerate()
                .map(|(index, x)| f64::from(x.dot(self.blocks[self.rows[base + index].start] * *x)))
                .sum::<f64>()
        }))
    }

    fn assemble(
        &mut self,
        elastic: &ElasticForces,
        inverse_masses: &[f64],
        points: &[PointForce],
        dt: f64,
    ) {
        let (columns, contributions) = (&self.columns, &self.contributions);
        let mut rest = &mut self.blocks[..];
        let mut parts = Vec::with_capacity(self.rows.len().div_ceil(CHUNK));
        for (rows, inverse) in self.rows.chunks(CHUNK).zip(self.inverse.chunks_mut(CHUNK)) {
            let blocks: usize = rows.iter().map(|row| row.end - row.start).sum();
            let (part, others) = rest.split_at_mut(blocks);
            parts.push((rows, inverse, part));
            rest = others;
        }
        parts.into_par_iter().enumerate().for_each(|(chunk, (rows, inverse, blocks))| {
            let first = rows[0].start;
            for (index, row) in rows.iter().enumerate() {
                let v = chunk * CHUNK + index;
                let blocks = &mut blocks[row.start - first..row.end - first];
                blocks.fill(Mat3::ZERO);
                if inverse_masses[v] == 0.0 {
                    blocks[0] = Mat3::IDENTITY;
                    inverse[index] = Mat3::IDENTITY;
                    continue;
                }
                let [from, to] = row.contributions;
                elastic.add_stiffness(&contributions[from..to], blocks);
                for (block, &column) in blocks.iter_mut().zip(&columns[row.start..row.end]) {
                    if inverse_masses[column as usize] == 0.0 {
                        *block = Mat3::ZERO;
                    }
                }
                let point = &points[v];
                let mass = 1.0 / inverse_masses[v] + dt * dt * point.stiffness;
                let own = DMat3::from_diagonal(DVec3::splat(mass)) + point.drag * dt;
                blocks[0] += own.as_mat3();
                inverse[index] = blocks[0].inverse();
            }
        });
    }

    /// Blocks and columns of a row from `start` to `end`.
    fn part(&self, start: usize, end: usize) -> impl DoubleEndedIterator<Item = (&Mat3, usize)> {
        self.blocks[start..end].iter().zip(self.columns[start..end].iter().map(|&c| c as usize))
    }

    /// Replaces `x` by the solution of `(D + U) y = x` in a chunk.
    fn solve_upper(&self, chunk: usize, x: &mut [Vec3]) {
        let base = chunk * CHUNK;
        for index in (0..x.len()).rev() {
            let Row { start, outer, .. } = self.rows[base + index];
            let above = self
                .part(start + 1, outer)
                .fold(x[index], |sum, (block, column)| sum - *block * x[column - base]);
            x[index] = self.inverse[base + index] * above;
        }
    }

    /// Replaces `x` by the solution of `(D + L) y = x` in a chunk.
    fn solve_lower(&self, chunk: usize, x: &mut [Vec3]) {
        let base = chunk * CHUNK;
        for index in 0..x.len() {
            let own = self.inverse[base + index] * x[index];
            x[index] = own;
            let Row { start, outer, .. } = self.rows[base + index];
            for (block, column) in self.part(start + 1, outer) {
                x[column - base] -= block.mul_transpose_vec3(own);
            }
        }
    }

    /// Conjugate gradients on `(D + L)⁻¹ A (D + U)⁻¹ x̂ = (D + L)⁻¹ b` with the preconditioner `D⁻¹`, until
    /// the residual's [`energy`](Self::energy) is at most `enough`.
    fn conjugate_gradients(&self, right: &[Vec3], enough: f64) -> Vec<Vec3> {
        let count = right.len();
        let mut residual = right.to_vec();
        let mut scaled = vec![Vec3::ZERO; count];
        let chunks = residual.par_chunks_mut(CHUNK).zip(scaled.par_chunks_mut(CHUNK)).enumerate();
        let sums = chunks.map(|(chunk, (residual, scaled))| {
            self.solve_lower(chunk, residual);
            self.scale(chunk, residual, scaled)
        });
        let mut energy = in_order(sums);
        let mut solution = vec![Vec3::ZERO; count];
        let mut direction = vec![Vec3::ZERO; count];
        let mut image = vec![Vec3::ZERO; count];
        // (D + U)⁻¹ times the direction.
        let mut moved = vec![Vec3::ZERO; count];
        let mut ratio = 0.0f32;
        for _ in 0..ITERATIONS {
            if energy <= enough || energy <= f64::MIN_POSITIVE {
                break;
            }
            let chunks = direction.par_chunks_mut(CHUNK).zip(moved.par_chunks_mut(CHUNK));
            chunks.zip(scaled.par_chunks(CHUNK)).enumerate().for_each(
                |(chunk, ((direction, moved), scaled))| {
                    for (direction, &scaled) in direction.iter_mut().zip(scaled) {
                        *direction = scaled + *direction * ratio;
                    }
                    moved.copy_from_slice(direction);
                    self.solve_upper(chunk, moved);
                },
            );
            let chunks = image.par_chunks_mut(CHUNK).zip(direction.par_chunks(CHUNK)).enumerate();
            let curvature = in_order(chunks.map(|(chunk, (image, direction))| {
                let base = chunk * CHUNK;
                for (index, image) in image.iter_mut().enumerate() {
                    let Row { start, outer, end, .. } = self.rows[base + index];
                    let own = direction[index] - self.blocks[start] * moved[base + index];
                    *image = self
                        .part(outer, end)
                        .fold(own, |sum, (block, column)| sum + *block * moved[column]);
                }
                self.solve_lower(chunk, image);
                let mut sum = 0.0;
                for (index, image) in image.iter_mut().enumerate() {
                    *image += moved[base + index];
                    sum += f64::from(image.dot(direction[index]));
                }
                sum
            }));
            if curvature <= 0.0 || curvature.is_nan() {
                break;
            }
            let step = (energy / curvature) as f32;
            let chunks = solution.par_chunks_mut(CHUNK).zip(residual.par_chunks_mut(CHUNK));
            let chunks = chunks.zip(scaled.par_chunks_mut(CHUNK)).enumerate();
            let next = in_order(chunks.map(|(chunk, ((solution, residual), scaled))| {
                let base = chunk * CHUNK;
                for index in 0..solution.len() {
                    solution[index] += direction[base + index] * step;
                    residual[index] -= image[base + index] * step;
                }
                self.scale(chunk, residual, scaled)
            }));
            ratio = (next / energy) as f32;
            energy = next;
        }
        solution
            .par_chunks_mut(CHUNK)
            .enumerate()
            .for_each(|(chunk, solution)| self.solve_upper(chunk, solution));
        solution
    }

    /// Sets `scaled` to the diagonal times `x` in a chunk, and returns their scalar product.
    fn scale(&self, chunk: usize, x: &[Vec3], scaled: &mut [Vec3]) -> f64 {
        let mut sum = 0.0;
        for (index, (&x, scaled)) in x.iter().zip(scaled).enumerate() {
            *scaled = self.blocks[self.rows[chunk * CHUNK + index].start] * x;
            sum += f64::from(x.dot(*scaled));
        }
        sum
    }
}

/// Sum of the chunks' numbers, in their order.
fn in_order(sums: impl IndexedParallelIterator<Item = f64>) -> f64 {
    sums.collect::<Vec<f64>>().into_iter().sum()
}
