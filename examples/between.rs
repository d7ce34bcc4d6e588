//! Goes from one code to another, and draws the way.
//!
//! ```sh
//! cargo run --release --example between -- demo/run
//! ```

use std::path::PathBuf;

use cape::{
    infer::interpolate_codes,
    prelude::*,
    render::{Object, Style, Tile, View, contact_sheet, portrait},
    synth::poses,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = PathBuf::from(std::env::args().nth(1).ok_or("expected a run's directory")?);
    let run = Run::open(&path, &Device::default())?;
    let [a, b] = [1, 2].map(|seed| run.sample_codes(1, seed).into_raw_vec_and_offset().0);
    let codes = interpolate_codes(&a, &b, 5);
    let pose = poses::preset("a-pose").ok_or("no such pose")?;
    let wearer = BodySpec { betas: Vec::new(), pose, outfit: Outfit::SHORT_LONG };
    let mut tiles = Vec::new();
    for mesh in run.dress(&codes, &vec![wearer; 5])? {
        let style = Style { width: 240, height: 352, ..Style::default() };
        let image = portrait(Object::new(&mesh), View::ThreeQuarter, &style)?;
        tiles.push(Tile { image, label: String::new() });
    }
    contact_sheet(&tiles, 5, None)?.save("between.png")?;
    Ok(())
}
