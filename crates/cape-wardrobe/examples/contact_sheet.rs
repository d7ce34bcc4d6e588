//! Draws a subject in outfits and motions: `contact_sheet OUT.png OUTFIT,… MOTION,… [SUBJECT]
//! [RESOLUTION_MM] [male|female|neutral]`.

use std::{error::Error, time::Instant};

use cape_core::{Mesh, Outfit, smpl::Gender};
use cape_render::{Object, Style, Tile, View, contact_sheet, portrait};
use cape_synth::{Motion, SynthSpec, embedded_body};
use cape_wardrobe::{SimulatedCaptures, WardrobeOptions};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, out, outfits, motions, more @ ..] = &arguments[..] else {
        return Err("expected OUT.png OUTFIT,… MOTION,…".into());
    };
    let outfits = outfits.split(',').map(str::parse).collect::<Result<Vec<Outfit>, _>>()?;
    let motions = motions.split(',').map(str::parse).collect::<Result<Vec<Motion>, _>>()?;
    let subject = more.first().map_or(Ok(0), |text| text.parse::<usize>())?;
    let millimetres = more.get(1).map_or(Ok(25.0), |text| text.parse::<f64>())?;
    let gender = more.get(2).map_or(Ok(Gender::Female), |text| text.parse())?;
    let body = embedded_body(gender)?;
    let columns = motions.len();
    let spec = SynthSpec {
        subjects: subject + 1,
        outfits,
        motions,
        frames_per_sequence: 8,
        ..SynthSpec::default()
    };
    let options = WardrobeOptions { resolution: 1e-3 * millimetres, ..WardrobeOptions::default() };
    let captures = SimulatedCaptures::new(&body, spec, options)?;
    let style = Style { width: 360, height: 480, ..Style::default() };
    let mut tiles = Vec::new();
    for take in captures.takes().iter().filter(|take| take.subject == subject) {
        let start = Instant::now();
        let (frames, quality) = captures.simulate(take)?;
        let label = captures.name(take);
        println!("{label}: {:.1} s, {quality:?}", start.elapsed().as_secs_f64());
        let Some(last) = frames.last() else { continue };
        let vertices = last.v_posed.rows().into_iter().map(|row| [row[0], row[1], row[2]]);
        let mesh = Mesh { vertices: vertices.collect(), faces: body.faces.clone() };
        let image = portrait(Object::new(&mesh), View::ThreeQuarter, &style)?;
        tiles.push(Tile { image, label });
    }
    contact_sheet(&tiles, columns, None)?.save(out)?;
    Ok(())
}
