//! Puts one texture on a body and on the same body in clothes: every vertex keeps its place on it.
//!
//! ```sh
//! cargo run --release --example texture -- demo/run
//! ```

use std::path::PathBuf;

use cape::{
    core::obj::Uv,
    prelude::*,
    render::{Image, Object, Style, Texture, Tile, View, contact_sheet, portrait},
    synth::poses,
};

/// Squares of the texture a metre.
const SQUARES: f32 = 22.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = PathBuf::from(std::env::args().nth(1).ok_or("expected a run's directory")?);
    let run = Run::open(&path, &Device::default())?;
    let pose = poses::preset("a-pose").ok_or("no such pose")?;
    let wearers = Outfit::PAPER.map(|outfit| BodySpec { betas: Vec::new(), pose, outfit });
    let mut bodies = run.pose_unclothed(&wearers[..1])?;
    bodies.extend(run.dress(&run.sample_codes(4, 2), &wearers)?);

    // Seen from the front at rest; SMPL's own coordinates come with `obj::read`.
    let rest = run.body().mesh();
    let coordinates = rest.vertices.iter().map(|v| [v[0], v[1]].map(|x| 0.5 * SQUARES * x));
    let uv = Uv { coordinates: coordinates.collect(), faces: rest.faces };
    let mut image = Image::new(2, 2, [236, 224, 196, 255])?;
    for at in [0, 3] {
        image.pixels_mut()[at] = [58, 92, 128, 255];
    }
    let image = magnified(&image, 64)?;
    let texture = Texture { uv: &uv, image: &image };
    let style = Style { width: 300, height: 420, ..Style::default() };
    let mut tiles = Vec::new();
    for (mesh, label) in
        bodies.iter().zip(["body"].into_iter().chain(Outfit::PAPER.iter().map(Outfit::name)))
    {
        let image = portrait(Object::new(mesh).with_texture(texture), View::ThreeQuarter, &style)?;
        tiles.push(Tile { image, label: label.to_owned() });
    }
    Ok(contact_sheet(&tiles, 5, None)?.save("texture.png")?)
}

/// Every pixel `times` as wide and high.
fn magnified(image: &Image, times: u32) -> Result<Image, cape::render::Error> {
    let (width, height) = (image.width() * times, image.height() * times);
    let mut large = Image::new(width, height, [0; 4])?;
    for (i, pixel) in large.pixels_mut().iter_mut().enumerate() {
        let (x, y) = (i as u32 % width / times, i as u32 / width / times);
        *pixel = image.get(x, y).unwrap_or_default();
    }
    Ok(large)
}
