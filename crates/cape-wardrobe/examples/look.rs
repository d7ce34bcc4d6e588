use std::time::Instant;
use cape_core::{Mesh, Outfit};
use cape_render::{Object, Style, Tile, View, contact_sheet, portrait};
use cape_synth::{Motion, SynthSpec, synthetic_body};
use cape_wardrobe::{SimulatedCaptures, WardrobeOptions};
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let resolution: f64 = args[2].parse()?;
    let frames: usize = args[3].parse()?;
    let subject: usize = args[4].parse()?;
    let motions: Vec<Motion> = args[5].split(',').map(|m| m.parse().unwrap()).collect();
    let outfits: Vec<Outfit> = args[6].split(',').map(|m| m.parse().unwrap()).collect();
    let body = synthetic_body();
    let spec = SynthSpec { subjects: subject + 1, outfits, motions: motions.clone(), frames_per_sequence: frames, ..SynthSpec::default() };
    let mut options = WardrobeOptions { resolution, ..WardrobeOptions::default() };
    if let Some(s) = args.get(7) { options.simulation.substeps = s.parse()?; }
    let captures = SimulatedCaptures::new(&body, spec, options)?;
    let mut tiles = Vec::new();
    let style = Style { width: 420, height: 560, ..Style::default() };
    for take in captures.takes().iter().filter(|t| t.subject == subject) {
        let start = Instant::now();
        let (frames, quality) = captures.simulate(take)?;
        let seconds = start.elapsed().as_secs_f64();
        println!("{}: {seconds:.1} s, {:.3} s a frame, {quality:?}", captures.name(take), seconds / captures.simulated_frames() as f64);
        for (at, view) in [(frames.len() / 2, View::Front), (frames.len() - 1, View::ThreeQuarter)] {
            let frame = &frames[at];
            let vertices: Vec<[f32; 3]> = frame.v_posed.rows().into_iter().map(|r| [r[0], r[1], r[2]]).collect();
            let mesh = Mesh { vertices, faces: body.faces.clone() };
            tiles.push(Tile { image: portrait(Object::new(&mesh), view, &style)?, label: format!("{} {at}", captures.name(take)) });
        }
    }
    contact_sheet(&tiles, 2 * motions.len(), None)?.save(&args[1])?;
    Ok(())
}
