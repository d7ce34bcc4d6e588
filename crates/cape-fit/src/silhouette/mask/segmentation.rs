//! Outlines of COCO: polygons and run lengths.

use cape_render::MAX_SIDE;
use serde_json::Value;

use super::{Mask, values::refuse};
use crate::Result;

impl Mask {
    /// Mask of COCO's `segmentation`: polygons (lists of x and y, pixels) in an image of `size`
    /// (width, height), or run lengths (`size` and `counts`, a list or compressed text) with a size
    /// of their own. A pixel is inside of a polygon if its centre is.
    ///
    /// ```
    /// use cape_fit::Mask;
    ///
    /// let square = serde_json::json!([[1.0, 1.0, 3.0, 1.0, 3.0, 3.0, 1.0, 3.0]]);
    /// let runs = serde_json::json!({ "size": [4, 4], "counts": [5, 2, 2, 2, 5] });
    /// let mask = Mask::from_segmentation(&square, Some([4, 4]))?;
    /// assert_eq!(mask, Mask::from_segmentation(&runs, None)?);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// If it is neither, runs do not fill the image, or the size of the image is unknown.
    pub fn from_segmentation(segmentation: &Value, size: Option<[u32; 2]>) -> Result<Self> {
        match segmentation {
            Value::Object(_) => run_lengths(segmentation, size),
            Value::Array(polygons) => match size {
                Some(size) => fill_polygons(polygons, size),
                None => refuse(
                    "segmentation: polygons, but the size of the image is unknown: give the image, \
                     or its size by --image-size"
                        .into(),
                ),
            },
            _ => refuse("segmentation: expected polygons or run lengths".into()),
        }
    }
}

/// True for an object of run lengths.
pub(super) fn is_run_lengths(value: &Value) -> bool {
    value.get("counts").is_some() && value.get("size").is_some()
}

fn run_lengths(value: &Value, expected: Option<[u32; 2]>) -> Result<Mask> {
    let side = |at: usize| {
        let side = value.get("size")?.get(at)?.as_u64()?;
        u32::try_from(side).ok().filter(|side| (1..=MAX_SIDE).contains(side))
    };
    let Some((height, width)) = side(0).zip(side(1)) else {
        return refuse(format!(
            "segmentation: `size`, expected height and width of 1 to {MAX_SIDE}"
        ));
    };
    if let Some([w, h]) = expected.filter(|expected| *expected != [width, height]) {
        return refuse(format!(
            "segmentation: of an image of {width}×{height} pixels, expected {w}×{h}"
        ));
    }
    let counts = match value.get("counts") {
        Some(Value::String(text)) => decompress(text),
        Some(Value::Array(list)) => list.iter().map(Value::as_u64).collect(),
        _ => None,
    };
    let Some(counts) = counts else {
        return refuse("segmentation: `counts`, expected run lengths as a list or as text".into());
    };
    let pixels = u64::from(width) * u64::from(height);
    let total = counts.iter().fold(0u64, |sum, &count| sum.saturating_add(count));
    if total != pixels {
        return refuse(format!(
            "segmentation: runs of {total} pixels, expected {width}×{height} = {pixels}"
        ));
    }
    // Runs go down the columns and alternate between background and person.
    let mut covered = vec![false; pixels as usize];
    let mut at = 0u64;
    for (index, count) in counts.into_iter().enumerate() {
        if index % 2 == 1 {
            for pixel in at..at + count {
                let (column, row) = (pixel / u64::from(height), pixel % u64::from(height));
                covered[(row * u64::from(width) + column) as usize] = true;
            }
        }
        at += count;
    }
    Mask::new(width, height, covered)
}

/// Run lengths of COCO's text: groups of five bits, least first, in characters from `0`; the sixth
/// bit says that another group follows, the last group has a sign, and from the third run on the
/// difference to the run two before is written.
fn decompress(text: &str) -> Option<Vec<u64>> {
    let mut counts: Vec<i64> = Vec::new();
    let mut bytes = text.bytes();
    while let Some(first) = bytes.next() {
        let (mut value, mut shift, mut byte) = (0i64, 0u32, first);
        loop {
            let group = byte.checked_sub(48).filter(|group| *group < 64)?;
            if shift > 50 {
                return None;
            }
            value |= i64::from(group & 0x1f) << shift;
            shift += 5;
            if group & 0x20 == 0 {
                if group & 0x10 != 0 {
                    value |= -1 << shift;
                }
                break;
            }
            byte = bytes.next()?;
        }
        if counts.len() > 2 {
            value = value.checked_add(counts[counts.len() - 2])?;
        }
        counts.push(value);
    }
    counts.into_iter().map(|count| u64::try_from(count).ok()).collect()
}

fn fill_polygons(polygons: &[Value], [width, height]: [u32; 2]) -> Result<Mask> {
    if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
        return refuse(format!("segmentation: an image of {width}×{height} pixels"));
    }
    let mut covered = vec![false; width as usize * height as usize];
    for (at, polygon) in polygons.iter().enumerate() {
        let numbers: Option<Vec<f64>> =
            polygon.as_array().and_then(|list| list.iter().map(Value::as_f64).collect());
        let numbers = numbers.filter(|n| n.len() % 2 == 0 && n.iter().all(|x| x.is_finite()));
        let Some(numbers) = numbers else {
            return refuse(format!(
                "segmentation[{at}]: expected a list of x and y of each corner"
            ));
        };
        let (corners, _) = numbers.as_chunks::<2>();
        fill(corners, &mut covered, width as usize);
    }
    Mask::new(width, height, covered)
}

/// Covers the pixels whose centre is inside of a polygon, by the even-odd rule.
fn fill(corners: &[[f64; 2]], covered: &mut [bool], width: usize) {
    let mut crossings: Vec<f64> = Vec::new();
    for (row, line) in covered.chunks_exact_mut(width).enumerate() {
        let y = row as f64 + 0.5;
        crossings.clear();
        for (at, &[ax, ay]) in corners.iter().enumerate() {
            let [bx, by] = corners[(at + 1) % corners.len()];
            if (ay <= y) != (by <= y) {
                crossings.push(ax + (bx - ax) * (y - ay) / (by - ay));
            }
        }
        crossings.sort_by(f64::total_cmp);
        for &[start, end] in crossings.as_chunks::<2>().0 {
            // The casts clamp.
            let from = ((start - 0.5).ceil().max(0.0) as usize).min(width);
            let to = ((end - 0.5).ceil().max(0.0) as usize).min(width);
            if from < to {
                line[from..to].fill(true);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    /// Counts and their text, written by COCO's own tools from random masks.
    const WRITTEN: [(&str, &[u64]); 2] = [
        (
            "031N020N01000O51K00O10",
            &[0, 3, 1, 1, 1, 3, 1, 1, 1, 2, 1, 2, 1, 1, 6, 2, 1, 2, 1, 1, 2, 1],
        ),
        ("P1", &[32]),
    ];

    fn masks() -> impl Strategy<Value = Mask> {
        (1u32..40, 1u32..40, 0.0f64..1.0).prop_flat_map(|(width, height, share)| {
            let pixels = (width * height) as usize;
            prop::collection::vec(prop::bool::weighted(share), pixels)
                .prop_map(move |covered| Mask::new(width, height, covered).unwrap())
        })
    }

    /// Run lengths by going through the pixels column by column.
    fn runs(mask: &Mask) -> Vec<u64> {
        let (width, height) = (mask.width() as usize, mask.height() as usize);
        let mut counts = vec![0];
        let mut now = false;
        for column in 0..width {
            for row in 0..height {
                if mask.covered()[row * width + column] != now {
                    now = !now;
                    counts.push(0);
                }
                *counts.last_mut().unwrap() += 1;
            }
        }
        counts
    }

    /// The text by the definition of the format: the shortest two's complement in groups of five.
    fn compress(counts: &[u64]) -> String {
        let mut text = String::new();
        for (at, &count) in counts.iter().enumerate() {
            let before = if at > 2 { counts[at - 2] as i64 } else { 0 };
            let mut value = count as i64 - before;
            loop {
                let group = value & 0x1f;
                value >>= 5;
                let done = if group & 0x10 != 0 { value == -1 } else { value == 0 };
                let more = if done { 0 } else { 0x20 };
                text.push(char::from((group | more) as u8 + 48));
                if done {
                    break;
                }
            }
        }
        text
    }

    proptest! {
        #[test]
        fn run_lengths_are_those_of_brute_force(mask in masks()) {
            let counts = runs(&mask);
            let size = json!([mask.height(), mask.width()]);
            for counts in [json!(counts), json!(compress(&counts))] {
                let value = json!({ "size": size, "counts": counts });
                prop_assert_eq!(&Mask::from_segmentation(&value, None).unwrap(), &mask);
            }
        }

        #[test]
        fn polygons_cover_what_is_inside(
            corners in prop::collection::vec((-5.0f64..25.0, -5.0f64..25.0), 3..9),
        ) {
            let numbers: Vec<f64> = corners.iter().flat_map(|&(x, y)| [x, y]).collect();
            let mask = Mask::from_segmentation(&json!([numbers]), Some([20, 17])).unwrap();
            for (at, &covered) in mask.covered().iter().enumerate() {
                let (x, y) = ((at % 20) as f64 + 0.5, (at / 20) as f64 + 0.5);
                // Crossings of a ray to the right.
                let mut inside = false;
                for i in 0..corners.len() {
                    let ((ax, ay), (bx, by)) = (corners[i], corners[(i + 1) % corners.len()]);
                    if (ay <= y) != (by <= y) && ax + (bx - ax) * (y - ay) / (by - ay) <= x {
                        inside = !inside;
                    }
                }
                prop_assert_eq!(covered, inside, "{} {}", x, y);
            }
        }
    }

    #[test]
    fn text_of_coco_tools_is_read() {
        for (text, counts) in WRITTEN {
            assert_eq!(decompress(text).unwrap(), counts);
        }
    }

    #[test]
    fn outlines_that_are_none_are_refused() {
        for (value, part) in [
            (json!({ "size": [4, 4], "counts": [5, 2] }), "7 pixels"),
            (json!({ "size": [4, 4], "counts": "~" }), "counts"),
            (json!({ "size": [4, 4], "counts": "ooo" }), "counts"),
            (json!({ "size": [4, 4], "counts": [1, -1, 16] }), "counts"),
            (json!({ "size": [4, 4], "counts": [u64::MAX, u64::MAX] }), "expected 4×4"),
            (json!({ "size": [1u64 << 40, 4], "counts": [] }), "size"),
            (json!({ "size": [8, 4], "counts": [32] }), "4×8 pixels, expected 4×4"),
            (json!([[1.0, 2.0, 3.0]]), "segmentation[0]"),
            (json!([[1.0, "x"]]), "segmentation[0]"),
            (json!(7), "polygons or run lengths"),
        ] {
            let message = Mask::from_segmentation(&value, Some([4, 4])).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
        let polygon = json!([[0.0, 0.0, 4.0, 0.0, 4.0, 4.0]]);
        let message = Mask::from_segmentation(&polygon, None).unwrap_err().to_string();
        assert!(message.contains("--image-size"), "{message}");
    }
}
