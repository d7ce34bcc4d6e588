//! The binary chunk of a `.glb` file with its buffer views and accessors.

use serde_json::{Value, json};

const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_BYTE: u32 = 5121;

/// Target of a buffer view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Target {
    Vertices,
    Indices,
    Other,
}

#[derive(Debug, Default)]
pub(super) struct Buffer {
    pub(super) bytes: Vec<u8>,
    pub(super) views: Vec<Value>,
    pub(super) accessors: Vec<Value>,
}

impl Buffer {
    /// Appends raw bytes and returns the index of their view.
    pub(super) fn raw(&mut self, bytes: &[u8]) -> usize {
        self.view(bytes, Target::Other)
    }

    fn view(&mut self, bytes: &[u8], target: Target) -> usize {
        let offset = self.bytes.len().next_multiple_of(4);
        self.bytes.resize(offset, 0);
        self.bytes.extend(bytes);
        let mut view = json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() });
        match target {
            Target::Vertices => view["target"] = json!(34962),
            Target::Indices => view["target"] = json!(34963),
            Target::Other => {}
        }
        self.views.push(view);
        self.views.len() - 1
    }

    fn accessor(&mut self, view: usize, component: u32, count: usize, kind: &str) -> usize {
        self.accessors.push(json!({
            "bufferView": view, "componentType": component, "count": count, "type": kind,
        }));
        self.accessors.len() - 1
    }

    fn floats<const N: usize>(&mut self, rows: &[[f32; N]], kind: &str, target: Target) -> usize {
        let bytes: Vec<u8> = rows.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect();
        let view = self.view(&bytes, target);
        self.accessor(view, FLOAT, rows.len(), kind)
    }

    fn bounded<const N: usize>(&mut self, accessor: usize, rows: &[[f32; N]]) {
        let fold = |start: f32, pick: fn(f32, f32) -> f32| {
            let mut bound = [start; N];
            for row in rows {
                for (bound, &x) in bound.iter_mut().zip(row) {
                    *bound = pick(*bound, x);
                }
            }
            bound.to_vec()
        };
        self.accessors[accessor]["min"] = json!(fold(f32::INFINITY, f32::min));
        self.accessors[accessor]["max"] = json!(fold(f32::NEG_INFINITY, f32::max));
    }

    /// Appends points or directions, with their minimum and maximum if `bounded`; returns the
    /// accessor.
    pub(super) fn vec3(&mut self, rows: &[[f32; 3]], target: Target, bounded: bool) -> usize {
        let accessor = self.floats(rows, "VEC3", target);
        if bounded {
            self.bounded(accessor, rows);
        }
        accessor
    }

    pub(super) fn vec2(&mut self, rows: &[[f32; 2]]) -> usize {
        self.floats(rows, "VEC2", Target::Vertices)
    }

    pub(super) fn vec4(&mut self, rows: &[[f32; 4]]) -> usize {
        self.floats(rows, "VEC4", Target::Vertices)
    }

    pub(super) fn joints(&mut self, rows: &[[u8; 4]]) -> usize {
        let view = self.view(rows.as_flattened(), Target::Vertices);
        self.accessor(view, UNSIGNED_BYTE, rows.len(), "VEC4")
    }

    pub(super) fn indices(&mut self, indices: &[u32]) -> usize {
        let bytes: Vec<u8> = indices.iter().flat_map(|x| x.to_le_bytes()).collect();
        let view = self.view(&bytes, Target::Indices);
        self.accessor(view, UNSIGNED_INT, indices.len(), "SCALAR")
    }

    pub(super) fn matrices(&mut self, matrices: &[[f32; 16]]) -> usize {
        self.floats(matrices, "MAT4", Target::Other)
    }

    /// Appends the times of an animation, seconds; returns the accessor.
    pub(super) fn times(&mut self, times: &[f32]) -> usize {
        let (rows, _) = times.as_chunks::<1>();
        let accessor = self.floats(rows, "SCALAR", Target::Other);
        self.bounded(accessor, rows);
        accessor
    }

    /// Appends the sampled values of an animation; returns the accessor.
    pub(super) fn values<const N: usize>(&mut self, rows: &[[f32; N]], kind: &str) -> usize {
        self.floats(rows, kind, Target::Other)
    }
}
