//! Colour map of scalar values.

/// Nine evenly spaced colours of the map "viridis" (CC0), which is perceptually uniform, for colour
/// blindness and in grey too.
const VIRIDIS: [[f32; 3]; 9] = [
    [0.267, 0.005, 0.329],
    [0.279, 0.175, 0.483],
    [0.230, 0.322, 0.546],
    [0.173, 0.449, 0.558],
    [0.128, 0.567, 0.551],
    [0.158, 0.684, 0.502],
    [0.369, 0.789, 0.383],
    [0.678, 0.864, 0.190],
    [0.993, 0.906, 0.144],
];

/// sRGB colour, 0 to 1, of a value from 0 to 1 (dark blue, green, yellow). Values outside are clamped;
/// NaN is grey.
pub fn colormap(value: f32) -> [f32; 3] {
    if value.is_nan() {
        return [0.5; 3];
    }
    let last = VIRIDIS.len() - 1;
    let at = value.clamp(0.0, 1.0) * last as f32;
    let low = (at as usize).min(last - 1);
    let share = at - low as f32;
    [0, 1, 2].map(|i| VIRIDIS[low][i] + (VIRIDIS[low + 1][i] - VIRIDIS[low][i]) * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_interpolated_and_clamped() {
        assert_eq!(colormap(-1.0), VIRIDIS[0]);
        assert_eq!(colormap(2.0), VIRIDIS[8]);
        assert_eq!(colormap(0.5), VIRIDIS[4]);
        assert_eq!(colormap(f32::NAN), [0.5; 3]);
        // Brightness rises all the way.
        let brightness = |value: f32| {
            let [r, g, b] = colormap(value);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        assert!(
            (0..100).all(|k| brightness(k as f32 / 100.0) < brightness((k + 1) as f32 / 100.0))
        );
    }
}
