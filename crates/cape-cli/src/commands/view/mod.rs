//! The viewer in the browser.

mod assets;
mod bundle;
mod layer_source;
mod server;
mod site;
mod source;
mod wire;

use std::{
    collections::BTreeMap,
    net::{IpAddr, Ipv4Addr, TcpListener},
    path::{Path, PathBuf},
    sync::mpsc,
    thread,
};

use cape_data::raw::name_of;
use cape_infer::Run;
use cape_layer::Layer;
use clap::Args;
use serde::Serialize;

use crate::{
    body_source::BodyModelArgs,
    console::Console,
    error::{Context, Error, Result},
    motion_source::MotionFileArgs,
    options::{GlobalArgs, positive},
    page_server::token,
};
use layer_source::LayerSource;
use server::ServerState;
use source::{MeshSource, RunSource, Source};

/// View dressed bodies in the browser; change code, shape, pose and outfit.
///
/// A clothing layer (layer.npz of `cape layer learn`) is shown over a moving body, with sliders for its size
/// and material.
///
/// Serves a page to this machine only, at an address with a secret token, until Ctrl-C. From another
/// machine, forward the port by `ssh -L 8000:localhost:PORT` and open the address with port 8000.
///
/// --export writes a folder with the page and the model instead, for any file server or to be opened as a
/// file; the browser computes. The folder contains the body: SMPL's licence does not allow passing on SMPL.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  cape view\n  cape view runs/cape\n  cape view dressed.obj\n  cape view female\n  \
                        cape view learned/layer.npz\n  \
                        cape view frames --fps 15 --no-open --port 8080\n  cape view --export site"
)]
pub(crate) struct ViewArgs {
    /// Run, clothing layer (layer.npz), mesh (.obj, .ply, .stl, .off, .glb), SMPL body (.npz, .pkl), built-in
    /// body (male, female, neutral or sculpted), or directory of meshes as a sequence [default: the built-in
    /// model].
    #[arg(value_name = "RUN|LAYER|MESH|SEQUENCE")]
    path: Option<PathBuf>,
    #[command(flatten)]
    body: BodyModelArgs,
    /// Port to listen on; 0 selects a free one.
    #[arg(long, default_value_t = 0, value_name = "PORT")]
    port: u16,
    /// Address to listen on; other than this machine's own only with --allow-remote.
    #[arg(long, default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST), value_name = "ADDRESS")]
    host: IpAddr,
    /// Let other machines in; everyone who knows the address with its token can look, unencrypted.
    #[arg(long, requires = "host")]
    allow_remote: bool,
    #[command(flatten)]
    embedding: EmbeddingArgs,
    /// Frames per second of a sequence.
    #[arg(long, default_value_t = 30.0, value_name = "FPS", value_parser = positive)]
    fps: f64,
    /// File of a motion to offer beside the synthetic ones, for a run or a layer.
    #[arg(long, value_name = "FILE")]
    motion: Option<String>,
    #[command(flatten)]
    reading: MotionFileArgs,
    /// Do not open the browser.
    #[arg(long)]
    no_open: bool,
    /// Folder to write the page of a run into, with its model; it must be empty or missing.
    #[arg(
        long,
        value_name = "SITE",
        conflicts_with_all = ["port", "host", "allow_remote", "proxied", "fps", "no_open"]
    )]
    export: Option<PathBuf>,
    /// Number of held-out registrations in the folder, evenly spaced; the licence of the CAPE data does not
    /// allow passing them on.
    #[arg(long, default_value_t = 0, value_name = "N", requires = "export")]
    registrations: usize,
}

/// Options for other pages that show the viewer.
#[derive(Debug, Args)]
struct EmbeddingArgs {
    /// Let pages of other origins, such as notebooks, show the viewer in a frame.
    #[arg(long)]
    framed: bool,
    /// Answer to any name, for a proxy on this machine that asks for a password, such as JupyterLab's.
    #[arg(long)]
    proxied: bool,
}

/// Duration of a motion that is given by name, for a layer.
const SECONDS: f64 = 2.0;

#[derive(Debug, Serialize)]
struct Report {
    url: String,
}

#[derive(Debug, Serialize)]
struct SiteReport {
    site: PathBuf,
    /// Sizes of the files, bytes.
    files: BTreeMap<String, usize>,
    /// Size of all files.
    bytes: usize,
}

impl ViewArgs {
    pub(crate) fn run(self, global: &GlobalArgs, console: Console) -> Result {
        if !self.host.is_loopback() && !self.allow_remote {
            return Err(Error::message(format!(
                "--host {}: other machines could look: add --allow-remote, or leave both out and forward \
                 the port by `ssh -L 8000:localhost:PORT`",
                self.host
            )));
        }
        let device = global.device()?;
        let run = match &self.path {
            None => Some(cape_weights::pretrained(&device)?),
            Some(path) if Run::is_at(path) => Some(Run::open(path, &device)?),
            Some(_) => None,
        };
        let layer = self.path.as_deref().filter(|path| run.is_none() && Layer::is_at(path));
        if layer.is_none() && self.body.is_given() {
            return Err(Error::message("--body: only a clothing layer is shown on another body"));
        }
        let source = match (&run, layer) {
            (Some(run), _) => {
                let motion = self.motion.as_deref();
                let motion = motion.map(|text| self.reading.poses(text, console)).transpose()?;
                let source = RunSource::new(run, motion, console);
                if let Some(site) = &self.export {
                    return export(&source, site.clone(), self.registrations, console);
                }
                Source::Model(Box::new(source))
            }
            (None, _) if self.export.is_some() => {
                return Err(Error::message(
                    "--export: only a run can be exported, not a mesh or a layer",
                ));
            }
            (None, Some(path)) => {
                let model = self.body.load()?;
                let read = |text: &String| -> Result<_> {
                    let file = self.reading.motion(text, SECONDS, [None, None], console)?;
                    Ok((name_of(&file.path), file.motion_of(&model, &[], None)?))
                };
                let motion = self.motion.as_ref().map(read).transpose()?;
                Source::Layer(Box::new(LayerSource::open(path, model, motion)?))
            }
            (None, None) if self.motion.is_some() => {
                return Err(Error::message(
                    "--motion: only a run or a layer can be moved, not a mesh",
                ));
            }
            (None, None) => {
                let path = self.path.as_deref().unwrap_or_else(|| Path::new(""));
                Source::Meshes(MeshSource::open(path, self.fps)?)
            }
        };
        self.serve(&source, console)
    }

    fn serve(&self, source: &Source, console: Console) -> Result {
        let remote = !self.host.is_loopback();
        let scene = source.scene()?.to_string();
        let faces = source.faces().as_flattened().iter().flat_map(|i| i.to_le_bytes()).collect();

        let address = (self.host, self.port);
        let listener = TcpListener::bind(address)
            .map_err(|error| Error::io("socket", error))
            .doing(|| format!("listening on port {}", self.port))?;
        let address = listener.local_addr().map_err(|error| Error::io("socket", error))?;
        let (jobs, list) = mpsc::channel();
        let token = token();
        let report = Report { url: format!("http://{address}/{token}/") };
        let EmbeddingArgs { framed, proxied } = self.embedding;
        let site = ServerState { token, scene, faces, remote, proxied, framed, jobs };
        let server = thread::spawn(move || server::serve(listener, site));
        console.result(&report, || format!("{}\npress Ctrl-C to stop", report.url))?;
        if self.host.is_unspecified() {
            console.note(&format!("on another machine, put this machine's name for {}", self.host));
        }
        if !self.no_open && open::that_detached(&report.url).is_err() {
            console.note("cannot open a browser: open the address by hand");
        }
        server::work(list, |question| source.answer(question), |download| source.file(download));
        server.join().map_err(|_| Error::message("internal error: the server thread failed"))?
    }
}

fn export(source: &RunSource, site: PathBuf, registrations: usize, console: Console) -> Result {
    let files = site::export(source, &site, registrations)?;
    let bytes = files.values().sum();
    let report = SiteReport { site, files, bytes };
    console.result(&report, || {
        let page = report.site.join("index.html");
        let (count, size) = (report.files.len(), report.bytes as f64 / 1e6);
        format!("{count} files, {size:.1} MB\nopen {}", page.display())
    })
}
