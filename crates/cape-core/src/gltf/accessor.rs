//! Numbers of the accessors of a `.glb` file, checked against the length of its binary chunk.

use serde_json::Value;

/// Rows of an accessor: numbers of `width` components each, integers scaled to −1 to 1 or 0 to 1 if
/// they are normalised.
pub(super) struct Rows {
    pub(super) width: usize,
    pub(super) numbers: Vec<f32>,
}

impl Rows {
    pub(super) fn len(&self) -> usize {
        self.numbers.len() / self.width
    }

    /// Rows of `N` numbers.
    pub(super) fn fixed<const N: usize>(&self, name: &str) -> Result<Vec<[f32; N]>, String> {
        if self.width != N {
            return Err(format!("{name} of {} components, expected {N}", self.width));
        }
        Ok(self.numbers.as_chunks::<N>().0.to_vec())
    }
}

/// JSON document and binary chunk.
pub(super) struct Data<'a> {
    pub(super) document: &'a Value,
    pub(super) binary: &'a [u8],
}

/// Numbers in a buffer view.
struct Layout {
    /// Offset of the first element from the start of the view, bytes.
    offset: u64,
    count: u64,
    component: u64,
    width: usize,
}

impl Data<'_> {
    pub(super) fn rows(&self, accessor: u64) -> Result<Rows, String> {
        let named = |message: String| format!("accessor {accessor}: {message}");
        self.accessor(&self.document["accessors"][accessor as usize]).map_err(named)
    }

    fn accessor(&self, accessor: &Value) -> Result<Rows, String> {
        let count = accessor["count"].as_u64().ok_or("no count")?;
        let component = accessor["componentType"].as_u64().ok_or("no component type")?;
        let width = match accessor["type"].as_str() {
            Some("SCALAR") => 1,
            Some("VEC2") => 2,
            Some("VEC3") => 3,
            Some("VEC4") => 4,
            Some("MAT4") => 16,
            other => return Err(format!("type {other:?}, expected SCALAR, VEC2 to VEC4 or MAT4")),
        };
        let offset = accessor["byteOffset"].as_u64().unwrap_or(0);
        let layout = Layout { offset, count, component, width };
        let mut numbers = match accessor["bufferView"].as_u64() {
            Some(view) => self.numbers(view, &layout)?,
            // Zeros, of which no more are believed than the file has bytes.
            None if count <= self.binary.len() as u64 => vec![0.0; count as usize * width],
            None => return Err(format!("{count} elements without data")),
        };
        let sparse = &accessor["sparse"];
        if sparse.is_object() {
            let part = |name: &str, component: Option<u64>, width: usize| {
                let part = &sparse[name];
                let layout = Layout {
                    offset: part["byteOffset"].as_u64().unwrap_or(0),
                    count: sparse["count"].as_u64().unwrap_or(0),
                    component: component.or(part["componentType"].as_u64()).unwrap_or(0),
                    width,
                };
                self.numbers(part["bufferView"].as_u64().ok_or("no view of sparse data")?, &layout)
            };
            let (indices, values) =
                (part("indices", None, 1)?, part("values", Some(component), width)?);
            for (index, row) in indices.into_iter().zip(values.chunks_exact(width)) {
                let slot = numbers.chunks_exact_mut(width).nth(index as usize);
                slot.ok_or("a sparse index is out of range")?.copy_from_slice(row);
            }
        }
        if accessor["normalized"].as_bool() == Some(true) {
            let most = match component {
                5120 => 127.0,
                5121 => 255.0,
                5122 => 32767.0,
                5123 => 65535.0,
                _ => 1.0,
            };
            for x in &mut numbers {
                *x = (*x / most).max(-1.0);
            }
        }
        Ok(Rows { width, numbers })
    }

    fn numbers(&self, view: u64, layout: &Layout) -> Result<Vec<f32>, String> {
        let view = &self.document["bufferViews"][view as usize];
        if view["buffer"].as_u64() != Some(0) || self.document["buffers"][0]["uri"].is_string() {
            return Err("its data are outside of the file: export a single .glb".into());
        }
        let &Layout { offset, count, component, width } = layout;
        let size = match component {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            5125 | 5126 => 4,
            _ => return Err(format!("unknown component type {component}")),
        };
        let element = size * width as u64;
        let stride = view["byteStride"].as_u64().unwrap_or(element);
        let start = view["byteOffset"].as_u64().unwrap_or(0).checked_add(offset);
        let end = start.and_then(|start| {
            let last = count.checked_sub(1)?.checked_mul(stride)?;
            start.checked_add(last)?.checked_add(element)
        });
        let present = self.binary.len() as u64;
        let within = count == 0 || stride >= element && end.is_some_and(|end| end <= present);
        if !within {
            return Err(format!("{count} elements reach beyond the {present} bytes of the file"));
        }
        let start = start.unwrap_or(0);
        let mut numbers = Vec::with_capacity((count * width as u64) as usize);
        for row in 0..count {
            for column in 0..width as u64 {
                let at = (start + row * stride + column * size) as usize;
                numbers.push(decode(component, &self.binary[at..at + size as usize]));
            }
        }
        Ok(numbers)
    }

    /// Whole numbers of an accessor, such as vertex indices, which `f32` would round.
    pub(super) fn indices(&self, accessor: u64) -> Result<Vec<u32>, String> {
        let found = &self.document["accessors"][accessor as usize];
        let component = found["componentType"].as_u64().unwrap_or(0);
        if ![5121, 5123, 5125].contains(&component) || found["sparse"].is_object() {
            return Err(format!("accessor {accessor}: not a plain list of indices"));
        }
        if component != 5125 {
            return Ok(self.rows(accessor)?.numbers.into_iter().map(|x| x as u32).collect());
        }
        // As numbers of the same bits.
        let layout = Layout {
            offset: found["byteOffset"].as_u64().unwrap_or(0),
            count: found["count"].as_u64().unwrap_or(0),
            component: 5126,
            width: 1,
        };
        let view = found["bufferView"].as_u64().ok_or("indices without data")?;
        Ok(self.numbers(view, &layout)?.into_iter().map(f32::to_bits).collect())
    }
}

fn decode(component: u64, bytes: &[u8]) -> f32 {
    match (component, bytes) {
        (5120, &[a]) => f32::from(i8::from_le_bytes([a])),
        (5121, &[a]) => f32::from(a),
        (5122, &[a, b]) => f32::from(i16::from_le_bytes([a, b])),
        (5123, &[a, b]) => f32::from(u16::from_le_bytes([a, b])),
        (5125, &[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]) as f32,
        (5126, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
        _ => 0.0,
    }
}
