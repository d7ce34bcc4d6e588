//! Bodies in a compact file: one half of a mirror-symmetric body, quantised to 16 bits and deflated.

use std::io::{Read, Write};

use flate2::{Compression, read::ZlibDecoder, write::ZlibEncoder};
use glam::DVec3;
use ndarray::{Array2, Array3};

use super::{FACES, VERTICES, blend, figure::MIRRORED, rig::Weights, shape::DIRECTIONS, volume};
use crate::{Error, Result};
use cape_core::{
    SmplModel,
    joints::{JOINTS, PARENTS},
    obj::Uv,
};

/// First bytes of the uncompressed file.
const MAGIC: &[u8; 8] = b"capebod2";
/// Largest size of the uncompressed file, bytes.
const LARGEST: u64 = 4 << 20;
/// Joints that a vertex can follow.
const BONES: usize = 4;

/// Left half (x ≥ 0) of a mirror-symmetric body. Vertices with x = 0 come first.
#[derive(Debug, Clone, PartialEq)]
pub struct HalfBody {
    /// Source and licence of the data.
    pub provenance: String,
    /// Number of vertices with x = 0.
    pub midline: usize,
    /// Rest positions of the half's vertices, metres.
    pub vertices: Vec<DVec3>,
    /// Triangles of the half, oriented outwards.
    pub faces: Vec<[u32; 3]>,
    /// Ten shape directions, metres per standard deviation, each of the length of `vertices`.
    pub shapes: Vec<Vec<DVec3>>,
    /// Blend weights of the half's vertices: at most four joints each, rows sum to 1.
    pub weights: Vec<[f64; JOINTS]>,
    /// Rows of the joint regressor as (vertex of the whole body, weight): joints of the left side and
    /// the middle, in ascending order.
    pub regressor: Vec<Vec<(u32, f64)>>,
    /// Texture coordinates of the corners of the half's faces, then of their mirror images, the
    /// corners in the order of the half's.
    pub uv: Uv,
}

impl HalfBody {
    fn sides(&self) -> usize {
        self.vertices.len() - self.midline
    }

    /// Index of the mirror image of a vertex of the half.
    fn mirror(&self, vertex: u32) -> u32 {
        if (vertex as usize) < self.midline { vertex } else { vertex + self.sides() as u32 }
    }

    /// Index of the mirror image of a vertex of the whole body.
    pub(super) fn mirror_of_any(&self, vertex: u32) -> u32 {
        let half = self.vertices.len() as u32;
        if vertex >= half { vertex - self.sides() as u32 } else { self.mirror(vertex) }
    }

    /// Triangles of the whole body.
    fn all_faces(&self) -> Vec<[u32; 3]> {
        let mirrored = self.faces.iter().map(|&[a, b, c]| [a, c, b].map(|v| self.mirror(v)));
        self.faces.iter().copied().chain(mirrored).collect()
    }

    /// Vectors of the whole body from those of the half.
    fn whole(&self, half: &[DVec3]) -> Vec<DVec3> {
        let mirrored = half[self.midline..].iter().map(|p| DVec3::new(-p.x, p.y, p.z));
        half.iter().copied().chain(mirrored).collect()
    }

    /// Texture coordinates of the whole body.
    pub fn texture(&self) -> Uv {
        let half = self.faces.len();
        let faces = self.uv.faces.iter().enumerate();
        Uv {
            coordinates: self.uv.coordinates.clone(),
            faces: faces
                .map(|(i, &[a, b, c])| if i < half { [a, b, c] } else { [a, c, b] })
                .collect(),
        }
    }

    /// The body in SMPL's layout; pose directions are computed.
    pub fn model(&self) -> SmplModel {
        let vertices = self.whole(&self.vertices);
        let count = vertices.len();
        let mut weights: Vec<Weights> = self.weights.clone();
        weights.extend(self.weights[self.midline..].iter().map(|row| MIRRORED.map(|j| row[j])));
        let mut joint_regressor = Array2::zeros((JOINTS, count));
        for (row, joint) in self.regressor.iter().zip(stored_joints()) {
            for &(v, weight) in row {
                joint_regressor[[joint, v as usize]] = weight;
                if MIRRORED[joint] != joint {
                    joint_regressor[[MIRRORED[joint], self.mirror_of_any(v) as usize]] = weight;
                }
            }
        }
        let mut joints = [DVec3::ZERO; JOINTS];
        for ((joint, v), &weight) in joint_regressor.indexed_iter() {
            joints[joint] += vertices[v] * weight;
        }
        let shapes: Vec<Vec<DVec3>> = self.shapes.iter().map(|shape| self.whole(shape)).collect();
        let faces = self.all_faces();
        let mut poses = blend::pose_directions(&vertices, &weights, &joints);
        volume::restore_volume(&vertices, &faces, &weights, &joints, &mut poses);
        SmplModel {
            v_template: Array2::from_shape_fn((count, 3), |(v, c)| vertices[v][c]),
            shapedirs: Array3::from_shape_fn((count, 3, shapes.len()), |(v, c, d)| shapes[d][v][c]),
            posedirs: Array3::from_shape_fn((count, 3, (JOINTS - 1) * 9), |(v, c, d)| {
                poses[v][d][c]
            }),
            joint_regressor,
            weights: Array2::from_shape_fn((count, JOINTS), |(v, j)| weights[v][j]),
            parents: PARENTS.to_vec(),
            faces,
        }
    }

    /// Bytes of the file.
    ///
    /// # Errors
    /// If the body has not SMPL's counts of vertices and faces, or arrays differ in length.
    pub fn encode(&self) -> Result<Vec<u8>> {
        self.check()?;
        let mut out = Writer(MAGIC.to_vec());
        out.u16(self.provenance.len());
        out.0.extend(self.provenance.as_bytes());
        out.u16(self.midline);
        out.u16(self.vertices.len());
        out.vectors(&self.vertices);
        self.shapes.iter().for_each(|shape| out.vectors(shape));
        for corner in 0..3 {
            out.differences(self.faces.iter().map(|face| face[corner] as u16));
        }
        for rank in 0..BONES {
            let ranked: Vec<(usize, u16)> =
                self.weights.iter().map(|row| ranked_weights(row)[rank]).collect();
            out.0.extend(ranked.iter().map(|&(joint, _)| joint as u8));
            out.differences(ranked.iter().map(|&(_, weight)| weight));
        }
        for row in &self.regressor {
            out.u16(row.len());
            for &(v, _) in row {
                out.u16(v as usize);
            }
            out.numbers(row.iter().map(|&(_, weight)| weight));
        }
        out.u16(self.uv.coordinates.len());
        for axis in 0..2 {
            let values = self.uv.coordinates.iter();
            out.differences(values.map(|uv| (uv[axis].clamp(0.0, 1.0) * 65535.0).round() as u16));
        }
        for corner in 0..3 {
            out.differences(self.uv.faces.iter().map(|face| face[corner] as u16));
        }
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
        let packed = encoder.write_all(&out.0).and_then(|()| encoder.finish());
        packed.map_err(|error| Error::argument(format!("body file: {error}")))
    }

    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// If the bytes are truncated or inconsistent.
    pub fn decode(bytes: &[u8]) -> Result<Self> {
        let mut raw = Vec::new();
        ZlibDecoder::new(bytes)
            .take(LARGEST)
            .read_to_end(&mut raw)
            .map_err(|error| malformed(&format!("not deflated data: {error}")))?;
        let mut input = Reader(&raw);
        if input.bytes(MAGIC.len())? != MAGIC {
            return Err(malformed("does not begin with `capebod2`"));
        }
        let length = input.u16()?;
        let provenance = String::from_utf8(input.bytes(length)?.to_vec())
            .map_err(|_| malformed("the provenance is not UTF-8"))?;
        let midline = input.u16()?;
        let half = input.u16()?;
        let vertices = input.vectors(half)?;
        let shapes = (0..DIRECTIONS).map(|_| input.vectors(half)).collect::<Result<_>>()?;
        let faces = input.triples(FACES / 2)?;
        let mut weights = vec![[0.0; JOINTS]; half];
        for _ in 0..BONES {
            let joints = input.bytes(half)?;
            for ((row, &joint), weight) in
                weights.iter_mut().zip(joints).zip(input.differences(half)?)
            {
                let slot = row.get_mut(joint as usize);
                *slot.ok_or_else(|| malformed("joint of a blend weight out of range"))? +=
                    f64::from(weight) / 65535.0;
            }
        }
        let mut regressor = Vec::new();
        for _ in stored_joints() {
            let count = input.u16()?;
            let at: Vec<usize> = (0..count).map(|_| input.u16()).collect::<Result<_>>()?;
            let weights = input.numbers(count)?;
            let sum: f64 = weights.iter().sum();
            if sum.abs() < 0.5 {
                return Err(malformed("weights of a joint's regressor do not sum to 1"));
            }
            regressor.push(at.into_iter().zip(weights).map(|(v, w)| (v as u32, w / sum)).collect());
        }
        let points = input.u16()?;
        let [u, v] = [input.differences(points)?, input.differences(points)?];
        let unit = |value: u16| f32::from(value) / 65535.0;
        let coordinates = u.into_iter().zip(v).map(|(u, v)| [unit(u), unit(v)]).collect();
        let uv = Uv { coordinates, faces: input.triples(FACES)? };
        let body = Self { provenance, midline, vertices, faces, shapes, weights, regressor, uv };
        body.check()?;
        Ok(body)
    }

    fn check(&self) -> Result<()> {
        let half = self.vertices.len();
        let whole = 2 * half - self.midline.min(half);
        let in_half = |face: &[u32; 3]| face.iter().all(|&v| (v as usize) < half);
        let points = self.uv.coordinates.len();
        let checks = [
            (self.midline <= half && whole == VERTICES, "6890 vertices"),
            (
                self.faces.len() == FACES / 2 && self.faces.iter().all(in_half),
                "6888 faces in the half",
            ),
            (self.shapes.len() == DIRECTIONS, "10 shape directions"),
            (
                self.shapes.iter().all(|shape| shape.len() == half),
                "shape directions of all vertices",
            ),
            (self.weights.len() == half, "blend weights of all vertices"),
            (self.regressor.len() == stored_joints().count(), "regressor rows of 15 joints"),
            (
                self.regressor.iter().flatten().all(|&(v, _)| (v as usize) < VERTICES),
                "regressor vertices below 6890",
            ),
            (points < 1 << 16 && self.uv.faces.len() == FACES, "texture coordinates of all faces"),
            (
                self.uv.faces.iter().flatten().all(|&point| (point as usize) < points),
                "texture coordinates that exist",
            ),
        ];
        match checks.iter().find(|(holds, _)| !holds) {
            Some((_, expected)) => Err(malformed(&format!("expected {expected}"))),
            None => Ok(()),
        }
    }
}

fn malformed(message: &str) -> Error {
    Error::argument(format!("body file: {message}"))
}

/// Joints of the left side and the middle.
fn stored_joints() -> impl Iterator<Item = usize> {
    (0..JOINTS).filter(|&joint| MIRRORED[joint] >= joint)
}

/// The four largest weights, in descending order, in units of 1/65535 that sum to 65535.
fn ranked_weights(row: &Weights) -> [(usize, u16); BONES] {
    let mut order: Vec<usize> = (0..JOINTS).collect();
    order.sort_by(|&a, &b| row[b].total_cmp(&row[a]));
    let mut ranked = [(0, 0); BONES];
    let mut rest = 65535;
    for (slot, &joint) in ranked.iter_mut().zip(&order).skip(1) {
        let weight = (row[joint] * 65535.0).round() as u16;
        *slot = (if weight == 0 { order[0] } else { joint }, weight);
        rest -= weight;
    }
    ranked[0] = (order[0], rest);
    ranked
}

struct Writer(Vec<u8>);

impl Writer {
    fn u16(&mut self, value: usize) {
        self.0.extend((value as u16).to_le_bytes());
    }

    /// Differences of successive numbers: their low bytes, then their high bytes.
    fn differences(&mut self, values: impl Iterator<Item = u16>) {
        let mut last = 0;
        let differences: Vec<u16> =
            values.map(|value| value.wrapping_sub(std::mem::replace(&mut last, value))).collect();
        self.0.extend(differences.iter().map(|d| d.to_le_bytes()[0]));
        self.0.extend(differences.iter().map(|d| d.to_le_bytes()[1]));
    }

    /// Vectors in units of 1/32767 of the largest coordinate.
    fn vectors(&mut self, vectors: &[DVec3]) {
        let largest = vectors.iter().map(|v| v.abs().max_element()).fold(1e-9, f64::max) as f32;
        self.0.extend(largest.to_le_bytes());
        for axis in 0..3 {
            self.differences(vectors.iter().map(|v| quantised(v[axis], largest)));
        }
    }

    /// Numbers in units of 1/32767 of the largest.
    fn numbers(&mut self, numbers: impl Iterator<Item = f64> + Clone) {
        let largest = numbers.clone().map(f64::abs).fold(1e-9, f64::max) as f32;
        self.0.extend(largest.to_le_bytes());
        for number in numbers {
            self.0.extend(quantised(number, largest).to_le_bytes());
        }
    }
}

/// Number in units of 1/32767 of the largest.
fn quantised(number: f64, largest: f32) -> u16 {
    let scaled = (number / f64::from(largest) * 32767.0).round();
    scaled.clamp(-32767.0, 32767.0) as i16 as u16
}

struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn bytes(&mut self, count: usize) -> Result<&'a [u8]> {
        let (head, tail) = self.0.split_at_checked(count).ok_or_else(|| malformed("truncated"))?;
        self.0 = tail;
        Ok(head)
    }

    fn u16(&mut self) -> Result<usize> {
        let bytes = self.bytes(2)?;
        Ok(usize::from(bytes[0]) | usize::from(bytes[1]) << 8)
    }

    fn differences(&mut self, count: usize) -> Result<Vec<u16>> {
        let (low, high) = (self.bytes(count)?, self.bytes(count)?);
        let mut last = 0_u16;
        let differences = low.iter().zip(high).map(|(&low, &high)| u16::from_le_bytes([low, high]));
        Ok(differences
            .map(|difference| {
                last = last.wrapping_add(difference);
                last
            })
            .collect())
    }

    fn triples(&mut self, count: usize) -> Result<Vec<[u32; 3]>> {
        let corners =
            [self.differences(count)?, self.differences(count)?, self.differences(count)?];
        Ok((0..count)
            .map(|i| [0, 1, 2].map(|corner: usize| u32::from(corners[corner][i])))
            .collect())
    }

    /// Largest of numbers that follow in units of 1/32767 of it.
    fn scale(&mut self) -> Result<f64> {
        let scale = self.bytes(4)?;
        let largest = f64::from(f32::from_le_bytes([scale[0], scale[1], scale[2], scale[3]]));
        if largest.is_finite() { Ok(largest) } else { Err(malformed("scale is not finite")) }
    }

    fn numbers(&mut self, count: usize) -> Result<Vec<f64>> {
        let largest = self.scale()?;
        (0..count).map(|_| Ok(f64::from(self.u16()? as i16) * largest / 32767.0)).collect()
    }

    fn vectors(&mut self, count: usize) -> Result<Vec<DVec3>> {
        let largest = self.scale()?;
        let axes = [self.differences(count)?, self.differences(count)?, self.differences(count)?];
        let number = |value: u16| f64::from(value as i16) * largest / 32767.0;
        Ok((0..count)
            .map(|i| DVec3::new(number(axes[0][i]), number(axes[1][i]), number(axes[2][i])))
            .collect())
    }
}
