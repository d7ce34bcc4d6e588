//! Quadric edge collapse restricted to subset placement: a collapse keeps one of its two vertices,
//! so that the vertices of every level are a selection of those of the finest level.
//!
//! Trained weights depend on the selection, so the order of collapses, including ties, is that of
//! the original algorithm: a binary heap of `(cost, edge)` whose edges are renamed in place when a
//! vertex is removed.

use crate::topology::Surface;
use crate::vector::{V3, cross, dot, sub};
use crate::{Error, Result};

/// Faces at most vertices.
const VALENCE: usize = 8;

/// Simplified mesh.
///
/// ```
/// use cape_graph::{Surface, simplify};
///
/// let octahedron = Surface {
///     vertices: vec![
///         [1., 0., 0.], [-1., 0., 0.], [0., 1., 0.], [0., -1., 0.], [0., 0., 1.], [0., 0., -1.],
///     ],
///     faces: vec![
///         [0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5],
///     ],
/// };
/// let simplified = simplify(&octahedron, 5)?;
/// assert_eq!(simplified.kept.len(), 5);
/// // The kept vertices are not moved.
/// for (&kept, vertex) in simplified.kept.iter().zip(&simplified.surface.vertices) {
///     assert_eq!(octahedron.vertices[kept as usize], *vertex);
/// }
/// # Ok::<(), cape_graph::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Simplified {
    /// Indices of the kept vertices in the input, ascending.
    pub kept: Vec<u32>,
    /// The kept vertices and the remaining faces.
    pub surface: Surface,
}

/// Collapses edges of `surface` in the order of their cost until at most `target` vertices are left.
/// A mesh of at most `target` vertices is returned unchanged.
pub fn simplify(surface: &Surface, target: usize) -> Result<Simplified> {
    let vertices = surface.vertices.len();
    if target < 4 {
        return Err(Error::Target { vertices, target });
    }
    surface.validate_topology()?;
    let mut collapse = Collapse::new(surface);
    let mut queue = Queue::default();
    for edge in by_second(&surface.edges(), vertices) {
        queue.push(collapse.cost(edge).cheapest(), edge, &mut collapse.names);
    }

    while collapse.alive > target {
        let Some((popped, [r, c])) = queue.pop(&mut collapse.names) else { break };
        if r == c {
            continue;
        }
        let cost = collapse.cost([r, c]);
        if cost.cheapest() > popped {
            queue.push(cost.cheapest(), [r, c], &mut collapse.names);
        } else if cost.remove_c < cost.remove_r {
            collapse.remove(c, r);
        } else {
            collapse.remove(r, c);
        }
    }

    let simplified = collapse.finish();
    let (reached, faces) = (simplified.kept.len(), simplified.surface.faces.len());
    if reached > target || reached < 4 {
        return Err(Error::Collapsed { vertices, target, reached, faces });
    }
    Ok(simplified)
}

/// Sorted edges in the order of their second vertices.
fn by_second(edges: &[[u32; 2]], vertices: usize) -> Vec<[u32; 2]> {
    let mut places = vec![0; vertices + 1];
    for &[_, c] in edges {
        places[c as usize + 1] += 1;
    }
    for c in 0..vertices {
        places[c + 1] += places[c];
    }
    let mut sorted = vec![[0; 2]; edges.len()];
    for &edge in edges {
        let place = &mut places[edge[1] as usize];
        sorted[*place] = edge;
        *place += 1;
    }
    sorted
}

/// Sum of squared distances to a set of planes: the upper triangle of a symmetric 4 × 4 matrix.
#[derive(Debug, Clone, Copy, Default)]
struct Quadric([f64; 10]);

impl Quadric {
    /// Quadric of the plane of a triangle; zero for a triangle without area.
    fn of_plane([a, b, c]: [V3; 3]) -> Self {
        let normal = cross(sub(b, a), sub(c, a));
        let length = dot(normal, normal).sqrt();
        if length == 0.0 {
            return Self::default();
        }
        let [x, y, z] = normal.map(|n| n / length);
        let w = -dot([x, y, z], a);
        Self([x * x, x * y, x * z, x * w, y * y, y * z, y * w, z * z, z * w, w * w])
    }

    fn plus(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + other.0[i]))
    }

    fn at(self, [x, y, z]: V3) -> f64 {
        let [xx, xy, xz, xw, yy, yz, yw, zz, zw, ww] = self.0;
        (x * xx + y * xy + z * xz + xw) * x
            + (x * xy + y * yy + z * yz + yw) * y
            + (x * xz + y * yz + z * zz + zw) * z
            + (x * xw + y * yw + z * zw + ww)
    }
}

/// Cost of collapsing the edge `[r, c]`, by the vertex that is removed.
struct Cost {
    remove_r: f64,
    remove_c: f64,
}

impl Cost {
    fn cheapest(&self) -> f64 {
        if self.remove_r < self.remove_c { self.remove_r } else { self.remove_c }
    }
}

/// State of the simplification of a mesh.
struct Collapse<'a> {
    surface: &'a Surface,
    quadrics: Vec<Quadric>,
    /// Faces with removed vertices replaced; `None` for a face that has degenerated.
    faces: Vec<Option<[u32; 3]>>,
    /// Faces at each vertex; may include degenerated faces.
    around: Vec<Vec<u32>>,
    /// Number of remaining faces at each vertex.
    uses: Vec<u32>,
    /// Number of vertices with a remaining face.
    alive: usize,
    names: Names,
}

impl<'a> Collapse<'a> {
    fn new(surface: &'a Surface) -> Self {
        let n = surface.vertices.len();
        let mut quadrics = vec![Quadric::default(); n];
        let mut around: Vec<Vec<u32>> = (0..n).map(|_| Vec::with_capacity(VALENCE)).collect();
        for (index, face) in surface.faces.iter().enumerate() {
            let plane = Quadric::of_plane(face.map(|v| surface.vertices[v as usize]));
            for vertex in face.map(|v| v as usize) {
                quadrics[vertex] = quadrics[vertex].plus(plane);
                around[vertex].push(index as u32);
            }
        }
        Self {
            surface,
            quadrics,
            faces: surface.faces.iter().copied().map(Some).collect(),
            uses: around.iter().map(|faces| faces.len() as u32).collect(),
            around,
            alive: n,
            names: Names((0..n as u32).collect()),
        }
    }

    fn cost(&self, edge: [u32; 2]) -> Cost {
        let [r, c] = edge.map(|v| v as usize);
        let quadric = self.quadrics[r].plus(self.quadrics[c]);
        Cost {
            remove_r: quadric.at(self.surface.vertices[c]),
            remove_c: quadric.at(self.surface.vertices[r]),
        }
    }

    /// Replaces vertex `removed` by `kept` in every face.
    fn remove(&mut self, removed: u32, kept: u32) {
        self.names.0[removed as usize] = kept;
        let (d, k) = (removed as usize, kept as usize);
        self.quadrics[k] = self.quadrics[k].plus(self.quadrics[d]);
        for index in std::mem::take(&mut self.around[d]) {
            let Some(face) = &mut self.faces[index as usize] else { continue };
            if face.contains(&kept) {
                let face = *face;
                self.faces[index as usize] = None;
                for vertex in face {
                    self.release(vertex);
                }
            } else {
                for vertex in face.iter_mut().filter(|vertex| **vertex == removed) {
                    *vertex = kept;
                }
                self.around[k].push(index);
                if self.uses[k] == 0 {
                    self.alive += 1;
                }
                self.uses[k] += 1;
                self.release(removed);
            }
        }
    }

    /// Removes a face from the count of a vertex.
    fn release(&mut self, vertex: u32) {
        let uses = &mut self.uses[vertex as usize];
        *uses -= 1;
        if *uses == 0 {
            self.alive -= 1;
        }
    }

    fn finish(self) -> Simplified {
        let kept: Vec<u32> =
            (0..self.uses.len()).filter(|&v| self.uses[v] > 0).map(|v| v as u32).collect();
        let mut renumbered = vec![0; self.uses.len()];
        for (new, &old) in kept.iter().enumerate() {
            renumbered[old as usize] = new as u32;
        }
        let faces = self.faces.iter().flatten().map(|face| face.map(|v| renumbered[v as usize]));
        let surface = Surface {
            vertices: kept.iter().map(|&v| self.surface.vertices[v as usize]).collect(),
            faces: faces.collect(),
        };
        Simplified { kept, surface }
    }
}

/// Current name of every vertex: itself, or the vertex that it was merged into (a forest).
struct Names(Vec<u32>);

impl Names {
    fn now(&mut self, mut vertex: u32) -> u32 {
        while self.0[vertex as usize] != vertex {
            let parent = self.0[vertex as usize];
            self.0[vertex as usize] = self.0[parent as usize];
            vertex = parent;
        }
        vertex
    }

    fn edge_now(&mut self, [r, c]: [u32; 2]) -> [u32; 2] {
        [self.now(r), self.now(c)]
    }
}

/// Binary min-heap of `(cost, edge)` in which equal costs are ordered by the *current* names of the
/// edges. Renaming can break the heap property among equal costs, so that the result depends on the
/// movement of elements, which the heap of the standard library leaves unspecified. In this one, a
/// popped root is replaced by the last element, which sinks to the bottom along the smaller children
/// and rises again.
#[derive(Default)]
struct Queue(Vec<(f64, [u32; 2])>);

impl Queue {
    fn less(&self, a: usize, b: usize, names: &mut Names) -> bool {
        let ((cost_a, edge_a), (cost_b, edge_b)) = (self.0[a], self.0[b]);
        if cost_a == cost_b {
            names.edge_now(edge_a) < names.edge_now(edge_b)
        } else {
            cost_a < cost_b
        }
    }

    fn push(&mut self, cost: f64, edge: [u32; 2], names: &mut Names) {
        self.0.push((cost, edge));
        self.rise(self.0.len() - 1, names);
    }

    /// Cost and current name of the cheapest edge; the cost is that of its push.
    fn pop(&mut self, names: &mut Names) -> Option<(f64, [u32; 2])> {
        if self.0.is_empty() {
            return None;
        }
        let (cost, edge) = self.0.swap_remove(0);
        let mut position = 0;
        while 2 * position + 1 < self.0.len() {
            let (left, right) = (2 * position + 1, 2 * position + 2);
            let child =
                if right < self.0.len() && !self.less(left, right, names) { right } else { left };
            self.0.swap(position, child);
            position = child;
        }
        self.rise(position, names);
        Some((cost, names.edge_now(edge)))
    }

    fn rise(&mut self, mut position: usize, names: &mut Names) {
        while position > 0 {
            let parent = (position - 1) / 2;
            if !self.less(position, parent, names) {
                break;
            }
            self.0.swap(position, parent);
            position = parent;
        }
    }
}
