//! Arrays of a body in the memory order of the kernel.

use crate::SmplModel;

/// Vertices per tile: the `f32` numbers of a cache line.
pub(super) const TILE: usize = 16;

/// One number for each vertex of a tile.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(64))]
pub(super) struct TileRow(pub [f32; TILE]);

/// Body in tiles of vertices, in `f32`. The last tile is padded with vertices without weights.
#[derive(Debug)]
pub(super) struct Tiles {
    vertices: usize,
    /// Number `K` of directions: template, `B` shape and `9·(J − 1)` pose directions.
    directions: usize,
    /// Directions, `[tiles, 3, K]`.
    rest: Vec<TileRow>,
    /// Joints with influence on each tile, from `starts[tile]` on, and the weights of its vertices.
    bones: Vec<u32>,
    weights: Vec<TileRow>,
    /// Offsets into `bones` and `weights`, `[tiles + 1]`.
    starts: Vec<usize>,
}

impl Tiles {
    /// Packs a valid body.
    pub(super) fn new(model: &SmplModel) -> Self {
        let v = model.vertices();
        let (shapes, poses) = (model.betas(), model.pose_blends());
        let directions = 1 + shapes + poses;
        let tiles = v.div_ceil(TILE);
        let mut rest = vec![TileRow::default(); tiles * 3 * directions];
        let (mut bones, mut weights, mut starts) = (Vec::new(), Vec::new(), vec![0]);
        for (tile, rest) in rest.chunks_exact_mut(3 * directions).enumerate() {
            let inside = tile * TILE..v.min((tile + 1) * TILE);
            for (axis, rest) in rest.chunks_exact_mut(directions).enumerate() {
                for (at, vertex) in inside.clone().enumerate() {
                    let shapes = (0..shapes).map(|k| model.shapedirs[[vertex, axis, k]]);
                    let poses = (0..poses).map(|k| model.posedirs[[vertex, axis, k]]);
                    let template = std::iter::once(model.v_template[[vertex, axis]]);
                    for (rest, value) in rest.iter_mut().zip(template.chain(shapes).chain(poses)) {
                        rest.0[at] = value as f32;
                    }
                }
            }
            for joint in 0..model.joints() {
                let mut moved = TileRow::default();
                for (moved, vertex) in moved.0.iter_mut().zip(inside.clone()) {
                    *moved = model.weights[[vertex, joint]] as f32;
                }
                if moved.0.iter().any(|&weight| weight != 0.0) {
                    bones.push(joint as u32);
                    weights.push(moved);
                }
            }
            starts.push(bones.len());
        }
        Self { vertices: v, directions, rest, bones, weights, starts }
    }

    /// Number of vertices `V`.
    pub(super) fn vertices(&self) -> usize {
        self.vertices
    }

    /// Number of directions `K`.
    pub(super) fn count(&self) -> usize {
        self.directions
    }

    /// Directions of one coordinate of a tile, `[K]`.
    pub(super) fn directions(&self, tile: usize, axis: usize) -> &[TileRow] {
        &self.rest[(tile * 3 + axis) * self.directions..][..self.directions]
    }

    /// Directions of `count` tiles, `[count, 3, K]`.
    pub(super) fn all_directions(&self, first: usize, count: usize) -> &[TileRow] {
        let size = 3 * self.directions;
        &self.rest[first * size..][..count * size]
    }

    /// Joints with influence on a tile and the weights of its vertices, `[bones]`.
    pub(super) fn bones(&self, tile: usize) -> (&[u32], &[TileRow]) {
        let bones = self.starts[tile]..self.starts[tile + 1];
        (&self.bones[bones.clone()], &self.weights[bones])
    }
}
