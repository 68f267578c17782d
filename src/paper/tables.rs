//! The paper's tables and figures, and those that it left out. Each is a function that asks the lab.

use super::lab::{Ask, Lab, digest};
use super::scale::{Data, Keys, Run, Variant};
use super::series;
use super::sheet::{Line, Row, Table};
use crate::dataset::denoise::Denoise;
use crate::dataset::job::TruthSettings;
use crate::dataset::sweep;
use crate::evaluate::find::TestSequence;
use crate::evaluate::inverse;
use crate::evaluate::inverter::{Inverter, WanOptions};
use crate::evaluate::method::Method;
use crate::evaluate::renderer;
use crate::evaluate::results::{BUDGET_PIXELS, Results};
use crate::evaluate::run;
use crate::report::steps::Steps;
use crate::util::picture;
use crate::util::progress::Progress;
use crate::util::text::plural;
use crate::util::text::short;
use crate::util::weights::inside;
use anyhow::{Context, Result};
use clap::ValueEnum;
use renderflow_frame::file;
use renderflow_frame::reach::Reach;
use renderflow_model::inverse::InverseNet;
use renderflow_renderer::Settings;

/// A table or a figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Part {
    /// Methods with their seconds and parameters: the paper's table 1
    Methods,
    /// Recovered albedo, normals, depth and material
    Inverse,
    /// How the bridge is trained: uniform or four times, with or without noise, one step or four
    Strategies,
    /// Losses on pictures
    Losses,
    /// Keyframe adapters
    Keyframes,
    /// What the bridge begins with: the albedo, the albedo under the unshadowed light, or deferred shading
    Input,
    /// Distances between keyframes
    Gaps,
    /// 1, 2 and 4 Euler steps
    Steps,
    /// Whether several runs give the same picture
    Determinism,
    /// Quality along a long sequence
    Progressive,
    /// Edits of a material in steps
    Editing,
    /// Path tracing in the same seconds
    Seconds,
    /// Error in high dynamic range, and flicker
    Range,
    /// Scenes that were learnt from, and scenes that were not
    Generalisation,
    /// Seconds by size of the picture
    Cost,
    /// Quality by amount of data, and by time of training
    Amount,
}

impl Part {
    /// Makes the table.
    pub(super) fn make(self, lab: &Lab) -> Result<Table> {
        match self {
            Self::Methods => methods(lab),
            Self::Inverse => inverse(lab),
            Self::Strategies => strategies(lab),
            Self::Losses => losses(lab),
            Self::Keyframes => keyframes(lab),
            Self::Input => input(lab),
            Self::Gaps => gaps(lab),
            Self::Steps => steps(lab),
            Self::Determinism => series::determinism(lab),
            Self::Progressive => series::progressive(lab),
            Self::Editing => editing(lab),
            Self::Seconds => seconds(lab),
            Self::Range => range(lab),
            Self::Generalisation => generalisation(lab),
            Self::Cost => cost(lab),
            Self::Amount => amount(lab),
        }
    }
}

/// Columns of most of the paper's tables.
const QUALITY: [&str; 3] = ["psnr_full", "ssim", "lpips_alex"];
/// Columns where seconds count too.
const WITH_SECONDS: [&str; 4] = ["psnr_full", "ssim", "lpips_alex", "seconds"];

/// The paper's network from starts that the paper does not have.
const FROM_DEFERRED: &str = "RenderFlow from deferred shading";
const FROM_CARRIED: &str = "RenderFlow from carried keyframes";

/// One row of the paper's network: its label, its run, its method, its steps, and the paper's numbers.
type Wan = (&'static str, Run, &'static str, u32, &'static str);

fn wan_rows(lab: &Lab, table: &mut Table, rows: &[Wan]) -> Result<()> {
    for (label, run, method, steps, paper) in rows {
        let results = lab.measure(&Ask { run: Some(*run), steps: *steps, ..lab.ask(&[method]) })?;
        table.add(Row::of(&results, method, label), paper);
    }
    Ok(())
}

/// Parameters in millions.
fn millions(lab: &Lab, run: Run) -> Result<String> {
    let file = |run: Run| -> Result<u64> {
        let bytes = file::read(&lab.train(run)?.weights())?;
        let tensors = safetensors::SafeTensors::deserialize(&bytes).context("weights")?;
        Ok(tensors.tensors().iter().map(|(_, tensor)| tensor.shape().iter().product::<usize>() as u64).sum())
    };
    let values = file(Run::Autoencoder)? + file(run)?;
    Ok(short(values as f64 / 1e6))
}

fn methods(lab: &Lab) -> Result<Table> {
    let mut table = Table::new(
        "Methods",
        "The paper's table 1. Seconds of the rows with keyframes leave out the truth of the keyframes. The two baselines from noise \
         are implementations of the paradigm (single frames and clips from noise, in many steps) on the same backbone and data: RGB-X \
         and DiffusionRenderer themselves are larger and start from image and video models.",
        &WITH_SECONDS,
    );
    let own = ["ibl", "deferred", "warp", "neural", "neural+keys", "pt1+oidn", "pt4+oidn"];
    let results = lab.measure(&lab.ask(&own))?;
    let published = ["16.903 / .882 / .105", "24.649 / .927 / .097, by Unreal", "", "", "", "", ""];
    for (id, paper) in own.iter().zip(published) {
        let label = results.about.methods.iter().find(|method| method.id == *id).map_or(*id, |method| &method.label);
        let mut row = Row::of(&results, id, label);
        if id.starts_with("neural") {
            row.note = format!("{} M parameters", short(lab.fusion.header().fusion.values() as f64 / 1e6));
        }
        table.add(row, paper);
    }
    let truth = results.sequences.iter().filter_map(|sequence| sequence.about.truth.seconds);
    let truth: Vec<f64> = truth.collect();
    let mut row = Row::named("path tracing, the truth itself");
    if !truth.is_empty() {
        row.set("seconds", truth.iter().sum::<f64>() / truth.len() as f64);
    }
    row.note = plural(lab.scale.spp[1], "sample");
    table.add(row, "more than 10 s");
    let [stills, clips] = lab.scale.noisy_steps;
    let rows: [Wan; 8] = [
        (
            "single frames from noise (as RGB-X)",
            Run::Noise { clips: false },
            "wan-stills",
            stills,
            "20.984 / .793 / .165, 2.19 s",
        ),
        ("clips from noise (as DiffusionRenderer)", Run::Noise { clips: true }, "wan", clips, "23.758 / .863 / .128, 1.40 s"),
        ("RenderFlow", Run::Base, "wan", 1, "24.214 / .874 / .113, .19 s"),
        ("RenderFlow, frame by frame", Run::Base, "wan-stills", 1, ""),
        ("RenderFlow with keyframes", Run::Keys(Keys::Whole), "wan+keys", 1, "26.663 / .883 / .101, .24 s"),
        ("RenderFlow with keyframes, frame by frame", Run::Keys(Keys::Whole), "wan-stills+keys", 1, ""),
        (FROM_DEFERRED, Run::Variant(Variant::Deferred), "wan", 1, ""),
        (FROM_CARRIED, Run::Keys(Keys::Carried), "wan+keys", 1, ""),
    ];
    for (label, run, method, steps, paper) in rows {
        let results = lab.measure(&Ask { run: Some(run), steps, ..lab.ask(&[method]) })?;
        let mut row = Row::of(&results, method, label);
        row.note = format!("{} M parameters, {steps} {}", millions(lab, run)?, if steps == 1 { "step" } else { "steps" });
        table.add(row, paper);
    }
    Ok(table)
}

/// Columns of the table on recovered buffers, by their ids in [`crate::metrics::intrinsics`].
const BUFFERS: [(&str, &str); 6] = [
    ("albedo_psnr", "albedo, PSNR"),
    ("albedo_lpips", "albedo, LPIPS"),
    ("normal_mean", "normals, degrees"),
    ("depth_relative", "depth"),
    ("roughness_rms", "roughness"),
    ("metallic_rms", "metallic"),
];

fn inverse(lab: &Lab) -> Result<Table> {
    let mut table = Table::new(
        "Inverse rendering",
        "Of the paper's numbers, the material is one for roughness and metallic together. What needs no network: the picture itself as \
         albedo, normals that face the camera, one depth, roughness .5 and metallic 0.",
        &[],
    );
    table.heads = BUFFERS.iter().map(|(_, head)| (*head).to_owned()).collect();
    let recipe = (lab.networks(Some(Run::Inverse))?, inside::<InverseNet>(), lab.scale.plan(Data::Test)?, lab.measured_by());
    table.rows = lab.kept("inverse", &(&table.heads, lab.scale.every, recipe), || recovered(lab))?;
    Ok(table)
}

/// The rows of the table on recovered buffers.
fn recovered(lab: &Lab) -> Result<Vec<Line>> {
    let autoencoder = lab.train(Run::Autoencoder)?.weights();
    let trained = lab.train(Run::Inverse)?.weights();
    let options = WanOptions { vae: Some(&autoencoder), tile: None };
    let wan = Inverter::open(Some(&trained), options, lab.fusion.device())?;
    let own = Inverter::open(None, WanOptions::default(), lab.fusion.device())?;
    let tests = lab.sequences(Data::Test, None)?;
    let mut rows: Vec<Line> = Vec::new();
    for (label, network, paper) in [("RenderFlow", wan, "26.93 / .153 / 16.2 degrees / material .084"), ("our network", own, "")]
    {
        let sets = inverse::measure(&inverse::Method::Network(network), &tests, lab.scale.every, lab.lpips, lab.cancel)?;
        for row in sets.first().iter().flat_map(|set| &set.rows) {
            let name = if row.method == "network" { label } else { row.method };
            if rows.iter().any(|(there, ..)| there == name) {
                continue;
            }
            let cell = |(id, _): &(&str, &str)| row.values.get(*id).map_or_else(|| "-".into(), |value| value.shown(3));
            let paper = if row.method == "network" { paper } else { "" };
            rows.push((name.to_owned(), BUFFERS.iter().map(cell).collect(), String::new(), paper.to_owned()));
        }
    }
    Ok(rows)
}

fn strategies(lab: &Lab) -> Result<Table> {
    let mut table = Table::new("Training strategies", "The bridge with (SDE) and without noise (ODE).", &QUALITY);
    let rows: [Wan; 5] = [
        ("uniform times, SDE, 4 steps", Run::Variant(Variant::UniformSde), "wan", 4, "22.192 / .858 / .120"),
        ("four times, ODE, 4 steps", Run::Variant(Variant::FourOde), "wan", 4, "23.089 / .865 / .110"),
        ("four times, ODE, 1 step", Run::Variant(Variant::FourOde), "wan", 1, "23.304 / .867 / .108"),
        ("four times, SDE, 4 steps", Run::Base, "wan", 4, "23.384 / .865 / .111"),
        ("four times, SDE, 1 step", Run::Base, "wan", 1, "23.590 / .868 / .107"),
    ];
    wan_rows(lab, &mut table, &rows)?;
    Ok(table)
}

fn losses(lab: &Lab) -> Result<Table> {
    let mut table = Table::new("Losses on pictures", "Besides the loss in latents.", &QUALITY);
    let rows: [Wan; 3] = [
        ("none", Run::Variant(Variant::LatentAlone), "wan", 1, "21.588 / .840 / .148"),
        ("LPIPS", Run::Variant(Variant::LatentAndLpips), "wan", 1, "23.538 / .867 / .105"),
        ("LPIPS and gradients", Run::Base, "wan", 1, "23.590 / .868 / .107"),
    ];
    wan_rows(lab, &mut table, &rows)?;
    if lab.lpips.alex.is_none() {
        table.text += " LPIPS was not part of any loss here: its weights were not found.";
    }
    Ok(table)
}

fn keyframes(lab: &Lab) -> Result<Table> {
    let mut table = Table::new(
        "Keyframe adapters",
        "Keyframes are 16 frames apart. Progressive: a clip begins with the picture of the last frame of the clip before it; without, \
         each frame is rendered by itself.",
        &QUALITY,
    );
    let rows: [Wan; 7] = [
        ("none", Run::Base, "wan-stills", 1, "23.590 / .868 / .107"),
        ("progressive only", Run::Base, "wan", 1, "25.042 / .877 / .102"),
        ("reused query, no correction", Run::Keys(Keys::Reused), "wan-stills+keys", 1, "24.520 / .862 / .098"),
        ("dedicated query, no correction", Run::Keys(Keys::Dedicated), "wan-stills+keys", 1, "25.217 / .878 / .097"),
        ("dedicated query, corrected perceptron", Run::Keys(Keys::Whole), "wan-stills+keys", 1, "25.720 / .881 / .094"),
        ("the same, progressive", Run::Keys(Keys::Whole), "wan+keys", 1, "26.220 / .885 / .090"),
        ("the same, from keyframes carried over deferred shading", Run::Keys(Keys::Carried), "wan+keys", 1, ""),
    ];
    wan_rows(lab, &mut table, &rows)?;
    let own = lab.measure(&lab.ask(&["warp", "neural", "neural+keys"]))?;
    for (id, label) in [("warp", "warped keyframes, no network"), ("neural", "our network, none"), ("neural+keys", "our network")]
    {
        table.add(Row::of(&own, id, label), "");
    }
    Ok(table)
}

fn input(lab: &Lab) -> Result<Table> {
    let mut table = Table::new(
        "What the bridge begins with",
        "The paper's experiment at low resolution, and a start that the paper does not have: from deferred shading, the autoencoder \
         codes the change of the picture and not the picture itself.",
        &QUALITY,
    );
    let rows: [Wan; 3] = [
        ("albedo", Run::Base, "wan", 1, "23.7 / .75 / .13"),
        ("albedo x irradiance", Run::Variant(Variant::Lit), "wan", 1, "25.6 / .76 / .13"),
        ("deferred shading", Run::Variant(Variant::Deferred), "wan", 1, ""),
    ];
    wan_rows(lab, &mut table, &rows)?;
    let own = lab.measure(&lab.ask(&["ibl", "deferred"]))?;
    table.add(Row::of(&own, "ibl", "IBL, no network"), "");
    table.add(Row::of(&own, "deferred", "deferred shading, no network"), "");
    Ok(table)
}

fn gaps(lab: &Lab) -> Result<Table> {
    let mut table = Table::new(
        "Distances between keyframes",
        "PSNR of the mean squared error of all frames, and mean PSNR of those that are no keyframes. Where some of the frames are \
         measured, keyframes count by their share of the sequence. The last column adds the truth of the keyframes to the seconds of \
         a frame.",
        &["psnr_all", "psnr_full", "ssim", "lpips_alex", "with_truth"],
    );
    let published = |gap: u32| match gap {
        13 => "29.716 (29.427) / .920 / .089",
        17 => "29.071 (28.812) / .917 / .092",
        25 => "26.574 (26.507) / .913 / .098",
        49 => "25.917 (25.737) / .909 / .102",
        _ => "",
    };
    let none = lab.measure(&Ask { run: Some(Run::Base), ..lab.ask(&["wan", "neural"]) })?;
    table.add(Row::of(&none, "wan", "RenderFlow, none"), "24.022 / .899 / .112");
    table.add(Row::of(&none, "neural", "our network, none"), "");
    for &gap in &lab.scale.gaps {
        let own = ["wan+keys", "neural+keys", "warp"];
        let ask = Ask { run: Some(Run::Keys(Keys::Whole)), gap: Some(gap), ..lab.ask(&own) };
        let results = lab.measure(&ask)?;
        for (id, label) in own.iter().zip(["RenderFlow", "our network", "warped keyframes, no network"]) {
            let paper = if *id == "wan+keys" { published(gap) } else { "" };
            table.add(Row::of(&results, id, &format!("{label}, {gap}")), paper);
        }
    }
    Ok(table)
}

fn steps(lab: &Lab) -> Result<Table> {
    let text = "Euler steps at inference. In the paper, 1 beats 2 and 4 by every metric, because errors add up.";
    let mut table = Table::new("Steps", text, &WITH_SECONDS);
    let rows: [Wan; 3] =
        [("1 step", Run::Base, "wan", 1, "best"), ("2 steps", Run::Base, "wan", 2, ""), ("4 steps", Run::Base, "wan", 4, "")];
    wan_rows(lab, &mut table, &rows)?;
    Ok(table)
}

fn seconds(lab: &Lab) -> Result<Table> {
    let mut table = Table::new(
        "The same seconds",
        "What path tracing with OIDN reaches in given seconds for a frame of 256 x 256 pixels, and with our network besides.",
        &["psnr_full", "ssim", "lpips_alex", "flip", "seconds"],
    );
    let base = ["ibl", "deferred", "neural", "pt1+fast", "pt2+fast", "pt1+oidn", "pt2+oidn", "pt4+oidn", "pt8+oidn"];
    let guided = ["pt1+oidn+gbuffer", "pt2+oidn+gbuffer", "pt4+oidn+gbuffer", "pt8+oidn+gbuffer"];
    let spread = ["pt4+adaptive+oidn+gbuffer", "pt8+adaptive+oidn"];
    let alone = ["pt2+adaptive+neural", "pt4+adaptive+neural", "pt8+adaptive+neural"];
    let with = ["pt1+oidn+neural", "pt2+oidn+neural", "pt4+oidn+neural", "pt8+oidn+neural"];
    let best = ["pt4+adaptive+oidn+neural", "pt8+adaptive+oidn+neural", "pt8+adaptive+oidn+neural+keys"];
    let all: Vec<&str> = base.into_iter().chain(guided).chain(spread).chain(alone).chain(with).chain(best).collect();
    let results = lab.measure(&lab.ask(&all))?;
    for (label, run, method) in [
        ("RenderFlow", Run::Base, "wan"),
        (FROM_DEFERRED, Run::Variant(Variant::Deferred), "wan"),
        (FROM_CARRIED, Run::Keys(Keys::Carried), "wan+keys"),
    ] {
        let results = lab.measure(&Ask { run: Some(run), ..lab.ask(&[method]) })?;
        table.add(Row::of(&results, method, label), "");
    }
    for method in &results.about.methods {
        table.add(Row::of(&results, &method.id, &method.label), "");
    }
    let pixels = f64::from(lab.scale.side).powi(2);
    if (pixels - BUDGET_PIXELS).abs() > 1.0 {
        table.text += &format!(" Here the frames have {0} x {0} pixels.", lab.scale.side);
    }
    Ok(table)
}

fn range(lab: &Lab) -> Result<Table> {
    let mut table = Table::new(
        "High dynamic range and flicker",
        "The relative squared error of radiance, the same without the worst of the pixels, and the change between frames that the \
         truth does not have. The paper measures display values only.",
        &["rel_mse", "rel_mse_robust", "flip", "temporal"],
    );
    let own = ["ibl", "deferred", "warp", "neural", "neural+keys", "pt4+oidn", "pt4+adaptive+neural", "pt4+adaptive+oidn+neural"];
    let results = lab.measure(&lab.ask(&own))?;
    for method in &results.about.methods {
        table.add(Row::of(&results, &method.id, &method.label), "");
    }
    for (label, run, method) in [
        ("RenderFlow", Run::Base, "wan"),
        ("RenderFlow with keyframes", Run::Keys(Keys::Whole), "wan+keys"),
        (FROM_DEFERRED, Run::Variant(Variant::Deferred), "wan"),
        (FROM_CARRIED, Run::Keys(Keys::Carried), "wan+keys"),
    ] {
        let results = lab.measure(&Ask { run: Some(run), ..lab.ask(&[method]) })?;
        table.add(Row::of(&results, method, label), "");
    }
    Ok(table)
}

fn generalisation(lab: &Lab) -> Result<Table> {
    let mut table = Table::new(
        "Scenes that were learnt from",
        "The same networks on scenes of their training and on the test scenes, whose mesh families and lights they never saw. Our \
         network learnt from other scenes, so both kinds are new to it.",
        &QUALITY,
    );
    let own = ["ibl", "deferred", "neural"];
    for (data, label) in [(Data::Seen, "learnt"), (Data::Test, "new")] {
        let ask = |methods| Ask { data, every: if data == Data::Seen { 4 } else { lab.scale.every }, ..lab.ask(methods) };
        for (name, run) in [("RenderFlow", Run::Base), (FROM_DEFERRED, Run::Variant(Variant::Deferred))] {
            let wan = lab.measure(&Ask { run: Some(run), ..ask(&["wan"]) })?;
            table.add(Row::of(&wan, "wan", &format!("{name}, {label}")), "");
        }
        let results = lab.measure(&ask(&own))?;
        for method in &results.about.methods {
            table.add(Row::of(&results, &method.id, &format!("{}, {label}", method.label)), "");
        }
    }
    Ok(table)
}

fn cost(lab: &Lab) -> Result<Table> {
    let text = "Seconds of a frame by the side of its picture in pixels.";
    let own = ["ibl", "deferred", "neural"];
    let mut table = Table::new("Seconds by size", text, &[]);
    let mut rows: Vec<(String, Vec<String>)> = Vec::new();
    for &side in &lab.scale.sides {
        let ask = |methods| Ask { data: Data::Side(side), every: 1, ..lab.ask(methods) };
        let results = lab.measure(&ask(&own))?;
        let wan = lab.measure(&Ask { run: Some(Run::Base), ..ask(&["wan-stills"]) })?;
        let of = |results: &Results, id: &str, label: &str| Row::of(results, id, label);
        let made = own.iter().map(|id| of(&results, id, label(&results, id)));
        for row in made.chain([of(&wan, "wan-stills", "RenderFlow, frame by frame")]) {
            let cell = row.cell("seconds");
            match rows.iter_mut().find(|(name, _)| *name == row.label) {
                Some((_, cells)) => cells.push(cell),
                None => rows.push((row.label.clone(), vec![cell])),
            }
        }
    }
    table.heads = lab.scale.sides.iter().map(|side| format!("{side}")).collect();
    table.rows = rows.into_iter().map(|(label, cells)| (label, cells, String::new(), String::new())).collect();
    Ok(table)
}

fn label<'r>(results: &'r Results, id: &'r str) -> &'r str {
    results.about.methods.iter().find(|method| method.id == id).map_or(id, |method| &method.label)
}

fn amount(lab: &Lab) -> Result<Table> {
    let mut table = Table::new("Data and time", "The paper's recipe with less data, and in less time.", &QUALITY);
    for (label, run) in [
        ("a quarter of the data", Run::Data(4)),
        ("half of the data", Run::Data(2)),
        ("a quarter of the time", Run::Time(4)),
        ("half of the time", Run::Time(2)),
        ("all of it", Run::Base),
    ] {
        let trained = lab.train(run)?;
        let results = lab.measure(&Ask { run: Some(run), ..lab.ask(&["wan"]) })?;
        let mut row = Row::of(&results, "wan", label);
        let (sequences, steps) = (plural(lab.scale.lesson(run).1, "sequence"), plural(trained.steps, "step"));
        row.note = format!("{sequences}, {steps} in {:.0} s", trained.seconds);
        table.add(row, "");
    }
    Ok(table)
}

fn editing(lab: &Lab) -> Result<Table> {
    let mut table =
        Table::new("Edits of materials", "PSNR, dB, at each step. The paper shows pictures of these edits and no numbers.", &[]);
    let steps = lab.scale.edit;
    let edits = sweep::published([lab.scale.side; 2]);
    let settings = TruthSettings::quiet(Settings { spp: lab.scale.spp[1], ..Settings::default() }, Denoise::Auto)?;
    let base = lab.out.join("data/edits");
    let swept = sweep::render(&edits, steps, &Reach::folder("."), &base, &settings, lab.cancel)?;
    let test = |(class, sequence)| TestSequence { set: "edit".into(), class, sequence };
    let tests: Vec<TestSequence> = swept.steps.into_iter().map(test).collect();
    let methods = ["ibl", "deferred", "neural", "wan-stills"].map(Method::parse).into_iter().collect::<Result<Vec<_>>>()?;
    let wan = lab.renderer(Run::Base)?;
    let truth = (steps, lab.scale.side, lab.scale.spp[1]);
    let recipe = digest(&(truth, lab.networks(Some(Run::Base))?, lab.measured_by()))?;
    let options = run::Options {
        rendering: renderer::Options {
            fusion: Some(lab.fusion),
            wan: Some(&*wan),
            timed: false,
            ..renderer::Options::new(&methods)
        },
        lpips: lab.lpips,
        every: 1,
        raw_truth: false,
        pictures: 1,
        title: "RenderFlow: edits".into(),
        settings: vec![("recipe".into(), recipe.clone())],
    };
    let out = lab.out.join("rows").join(format!("edits-{recipe}"));
    let progress = Progress::new("evaluating edits", tests.len() as u64);
    run::run(&tests, &options, &out, &progress, lab.cancel)?;
    progress.finish();
    let results = Results::read(&out)?;
    table.heads = results.about.methods.iter().map(|method| method.label.clone()).collect();
    for edit in &edits {
        let labels = (0..steps).map(|step| edit.label(step, steps)).collect();
        let made = Steps::new(&results, &edit.name, labels);
        for (label, cells) in made.psnr() {
            table.rows.push((format!("{}: {label}", edit.name), cells, String::new(), String::new()));
        }
        for (ending, bytes) in [("png", picture::png(&made.sheet()?)?), ("gif", made.animation()?)] {
            let name = format!("{}.{ending}", edit.name);
            file::write_atomic(&lab.out.join(&name), &bytes)?;
            if ending == "png" {
                table.pictures.push(name);
            }
        }
    }
    Ok(table)
}
