//! The command line as people expect it: names of options, what is said where, and what other programs read.

mod common;

use common::{fail, renderflow, stderr, succeed};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const PROGRAM: &str = env!("CARGO_BIN_EXE_renderflow");
/// Objects that move, and materials that do not change.
const MOVING: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/examples/moving_objects.json");

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn at(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    fn bytes(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&self.bytes(name)).unwrap()
    }

    fn model(&self) -> String {
        std::fs::write(self.path("a.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
        self.at("a.obj")
    }

    fn render(&self, words: &[&str], out: &str) -> Output {
        renderflow(&[&["render", "--spp", "1", "--denoise", "none", "-o", &self.at(out)][..], words].concat())
    }

    fn rendered(&self, words: &[&str], out: &str) -> Output {
        let output = self.render(words, out);
        assert!(output.status.success(), "{words:?}: {}", stderr(&output));
        output
    }
}

#[test]
fn every_command_shows_an_example() {
    let folder = Folder::new();
    succeed(&["man", "-o", &folder.at("man")]);
    let pages = common::files(&folder.path("man"));
    assert!(pages.len() >= 30, "{} pages", pages.len());
    for (name, page) in pages {
        let page = String::from_utf8(page).unwrap();
        let command: Vec<&str> = name.strip_suffix(".1").unwrap().split('-').collect();
        assert!(page.contains("Example"), "{name} has no example");
        assert!(page.contains(&command.join(" ")) || page.contains(&command.join("\\-")), "{name} is of another command");
    }
    succeed(&["man", "-o", &folder.at("man")]);
    std::fs::write(folder.path("man/renderflow.1"), "mine").unwrap();
    assert!(common::fail(&["man", "-o", &folder.at("man")]).contains("--overwrite"));
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = succeed(&["completions", shell]);
        assert!(script.contains("renderflow") && script.contains("testset"), "{shell}");
    }
}

/// The title of a command hid the rest of what its options say about it.
#[test]
fn long_help_says_what_a_command_does() {
    for (command, says) in [
        ("render", "Finished frames stay."),
        ("train", "Without --preset, this trains the fusion network"),
        ("infer", "in clips of five frames that overlap by one"),
        ("edit", "a red cone becomes smooth"),
        ("view", "at an address with a secret token"),
        ("check", "finds the kind by the content"),
        ("weights convert", "A file with a missing tensor"),
        ("evaluate relight", "The first frame of each sequence is inverted."),
        ("dataset pack", "Finished shards stay."),
    ] {
        let [long, short] = ["--help", "-h"].map(|option| {
            let words: Vec<&str> = command.split(' ').chain([option]).collect();
            succeed(&words)
        });
        assert!(long.contains(says), "{command}: {long}");
        assert!(!short.contains(says), "{command}: {short}");
        assert_eq!(long.lines().next(), short.lines().next(), "{command}");
    }
}

#[test]
fn the_scene_is_an_argument_and_a_model_one_picture() {
    let folder = Folder::new();
    let model = folder.model();
    let output = folder.rendered(&[&model, "--resolution", "24x16"], "new");
    assert!(!stderr(&output).contains("--scene"), "{}", stderr(&output));
    let scene = folder.json("new/scene.json");
    assert_eq!((&scene["resolution"], &scene["frames"]), (&serde_json::json!([24, 16]), &1.into()));
    assert!(folder.path("new/frame.0000.png").is_file() && !folder.path("new/frame.0001.exr").exists());
    // The earlier form says that it will go.
    let output = folder.rendered(&["--scene", &model, "--resolution", "24x16"], "old");
    assert!(stderr(&output).contains("note: --scene will be removed"), "{}", stderr(&output));
    assert_eq!(folder.bytes("old/frame.0000.exr"), folder.bytes("new/frame.0000.exr"));
    assert_eq!(folder.render(&[&model, "--scene", &model], "both").status.code(), Some(2));
    assert!(!succeed(&["render", "--help"]).contains("--scene "));
    let output = folder.render(&[&model, "--resolution", "24x0"], "bad");
    assert!(output.status.code() == Some(2) && stderr(&output).contains("0 is not in 1..=16384"), "{}", stderr(&output));
    // Sizes are written alike everywhere.
    succeed(&["compose", "--resolution", "48x32", "-o", &folder.at("scene.json")]);
    assert_eq!(folder.json("scene.json")["resolution"], serde_json::json!([48, 32]));
    let counts = ["--seed", "1", "--sequences", "1", "--mesh-count", "8", "--environment-count", "4"];
    succeed(&[&["dataset", "plan", "--resolution", "48x32", "-o", &folder.at("plan.json")][..], &counts].concat());
    assert_eq!(folder.json("plan.json")["resolution"], serde_json::json!([48, 32]));
}

/// The PNG of a frame is older than the EXR of the next one.
#[test]
fn pictures_can_be_looked_at_while_others_are_rendered() {
    let folder = Folder::new();
    folder.rendered(&[MOVING, "--frames", "4", "--resolution", "96"], "out");
    let time = |name: &str| std::fs::metadata(folder.path("out").join(name)).unwrap().modified().unwrap();
    for frame in 0..3 {
        assert!(time(&format!("frame.{frame:04}.png")) <= time(&format!("frame.{:04}.exr", frame + 1)), "frame {frame}");
    }
}

#[test]
fn sequences_get_longer() {
    let folder = Folder::new();
    let words = |frames: &'static str| [MOVING, "--resolution", "24", "--keyframe-gap", "2", "--frames", frames];
    folder.rendered(&words("5"), "whole");
    let compare = |out: &str| {
        for name in ["frame.0000", "frame.0001", "frame.0002", "frame.0003", "frame.0004"] {
            for ending in ["exr", "png"] {
                let name = format!("{name}.{ending}");
                assert!(folder.bytes(&format!("{out}/{name}")) == folder.bytes(&format!("whole/{name}")), "{out}: {name}");
            }
        }
        for name in ["scene.json", "transforms.json", "env.hdr"] {
            assert!(folder.bytes(&format!("{out}/{name}")) == folder.bytes(&format!("whole/{name}")), "{out}: {name}");
        }
    };
    folder.rendered(&words("3"), "out");
    let seconds = |out: &str| folder.json(&format!("{out}/timing.json"))["seconds"].as_array().unwrap().clone();
    let before = seconds("out");
    folder.rendered(&words("5"), "out");
    compare("out");
    // Two frames were kept, and three were rendered: the last one had no movement to a next frame.
    let after = seconds("out");
    assert_eq!((&after[..2], after.len()), (&before[..2], 5));
    assert_ne!(after[2], before[2]);

    // It was stopped after the descriptions were written, and goes on.
    folder.rendered(&words("3"), "stopped");
    std::fs::copy(folder.path("whole/scene.json"), folder.path("stopped/scene.json")).unwrap();
    std::fs::copy(folder.path("whole/transforms.json"), folder.path("stopped/transforms.json")).unwrap();
    for frame in ["frame.0000.exr", "frame.0001.exr"] {
        std::fs::copy(folder.path("whole").join(frame), folder.path("stopped").join(frame)).unwrap();
    }
    folder.rendered(&words("5"), "stopped");
    compare("stopped");

    // A shorter one, and other settings, are something else.
    let refused = folder.render(&words("2"), "out");
    assert!(stderr(&refused).contains("/frames was 5, now 2"), "{}", stderr(&refused));
    let refused = folder.render(&[&words("6")[..], &["--bsdf", "published"]].concat(), "out");
    assert!(stderr(&refused).contains("the BRDF was"), "{}", stderr(&refused));
    let refused = folder.render(&[&words("6")[..], &["--max-bounces", "3"]].concat(), "out");
    assert!(stderr(&refused).contains("the number of bounces was 6, now 3"), "{}", stderr(&refused));
    // A material that changes does so over the whole sequence.
    let mut scene = folder.json("out/scene.json");
    scene["materials"][0]["change"] = serde_json::json!({ "roughness": 0.7 });
    std::fs::write(folder.path("changing.json"), scene.to_string()).unwrap();
    let changing = folder.at("changing.json");
    folder.rendered(&[&changing, "--resolution", "16", "--frames", "2"], "changing");
    let refused = folder.render(&[&changing, "--resolution", "16", "--frames", "3"], "changing");
    let said = stderr(&refused);
    assert!(said.contains("/frames was 2, now 3") && said.contains("each length has other pictures"), "{said}");
}

#[test]
fn values_of_a_scene_are_set_on_the_command_line() {
    let folder = Folder::new();
    let plain = [MOVING, "--frames", "1", "--resolution", "16"];
    let set = |setting: &'static str| [&plain[..], &["--set", setting]].concat();
    folder.rendered(&set("materials/0/roughness=.2"), "out");
    assert_eq!(folder.json("out/scene.json")["materials"][0]["roughness"].as_f64().map(|v| v as f32), Some(0.2));
    // A file that is wrong is read where a setting puts it right.
    let mut scene: Value = serde_json::from_slice(&std::fs::read(MOVING).unwrap()).unwrap();
    scene["materials"][0]["roughness"] = 7.into();
    std::fs::write(folder.path("wrong.json"), scene.to_string()).unwrap();
    let wrong = folder.at("wrong.json");
    let refused = folder.render(&[&wrong, "--frames", "1", "--resolution", "16"], "wrong");
    assert!(stderr(&refused).contains("7 is outside 0..=1"), "{}", stderr(&refused));
    folder.rendered(&[&wrong, "--frames", "1", "--resolution", "16", "--set", "/materials/0/roughness=0.2"], "right");
    assert!(folder.bytes("right/frame.0000.exr") == folder.bytes("out/frame.0000.exr"));
    for (setting, words) in [
        ("materials/0/roughness=7", &["set: ", "/materials/0/roughness: 7 is outside 0..=1"][..]),
        ("materials/0/roughnes=.2", &["unknown field `roughnes`", "`roughness`"]),
        ("materials/99/roughness=.2", &["there is no \"99\"", "/materials has 0 to "]),
        ("camra/azimuth=.2", &["there is no \"camra\"", "the scene has", "camera"]),
    ] {
        let refused = folder.render(&set(setting), "refused");
        let said = stderr(&refused);
        assert_eq!(refused.status.code(), Some(1), "{setting}: {said}");
        assert!(words.iter().all(|word| said.contains(word)), "{setting}: {said}");
        assert!(!folder.path("refused").exists(), "{setting}");
    }
}

#[test]
fn reasons_are_said_once_and_name_what_there_is() {
    let folder = Folder::new();
    let model = folder.model();
    for words in [&["none.json"][..], &[&model, "--hdri", "nosuch"]] {
        let said = stderr(&folder.render(words, "out"));
        assert!(said.starts_with("error: ") && said.lines().count() == 1, "{said}");
        let times = |word: &str| said.matches(word).count();
        assert!(times("cannot read") + times("there is no such file") == 1, "{said}");
        assert!(times("No such file") <= 1 && times("nosuch") <= 1, "{said}");
    }
    let said = stderr(&folder.render(&[&model, "--hdri", "nosuch"], "out"));
    let names = renderflow_scenes::sky::names();
    assert!(names.len() >= 20 && names.iter().all(|name| said.contains(name)), "{said}");
    let help = succeed(&["render", "--help"]);
    assert!(names.iter().all(|name| help.contains(name)), "{help}");
}

#[test]
fn progress_and_log_are_chosen() {
    let folder = Folder::new();
    let model = folder.model();
    let render = |words: &[&str], log: Option<&str>, out: &str| {
        let mut command = Command::new(PROGRAM);
        command.args(["render", &model, "--resolution", "16", "--spp", "1", "--denoise", "none", "-t", "1", "-o"]);
        command.arg(folder.path(out)).args(words).env_remove("RENDERFLOW_LOG");
        let output = command.envs(log.map(|filter| ("RENDERFLOW_LOG", filter))).output().unwrap();
        (output.status.code(), stderr(&output))
    };
    let (code, usual) = render(&[], None, "usual");
    assert!(code == Some(0) && usual.contains("done in") && !usual.contains("INFO"), "{usual}");
    assert_eq!(render(&["-q"], None, "quiet"), (Some(0), String::new()));
    let (_, verbose) = render(&["-v"], None, "verbose");
    for word in ["INFO", "a.obj", "triangles=", "compiled", "features="] {
        assert!(verbose.contains(word), "{word}: {verbose}");
    }
    assert!(!verbose.contains("DEBUG"), "{verbose}");
    for said in [render(&["-vv"], None, "more").1, render(&["-q"], Some("renderflow=debug"), "filtered").1] {
        assert!(said.contains("DEBUG") && said.contains("frame=0"), "{said}");
    }
    let (code, said) = render(&[], Some("==x"), "bad");
    assert!(code == Some(1) && said.starts_with("error: RENDERFLOW_LOG===x: "), "{said}");
    assert_eq!(render(&["-q", "-v"], None, "both").0, Some(2));
}

#[test]
fn the_doctor_says_what_is_there() {
    let folder = Folder::new();
    let run = |weights: Option<&Path>, more: &[&str]| {
        let mut command = Command::new(PROGRAM);
        command.arg("doctor").args(more).env_remove("RENDERFLOW_LPIPS_WEIGHTS");
        let output = command.envs(weights.map(|folder| ("RENDERFLOW_LPIPS_WEIGHTS", folder))).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let found: Value = serde_json::from_str(&run(None, &["--json"])).unwrap();
    assert_eq!(found["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(found["denoiser"]["works"], renderflow_renderer::denoise::Denoiser::new().is_ok());
    assert!(found["cores"].as_u64().unwrap() >= 1 && found["simd"].is_string(), "{found}");
    assert!(found["network"]["works"].as_bool().unwrap() && found["network"]["steps"].as_u64().unwrap() > 0, "{found}");
    assert!(found["inverse"]["works"].as_bool().unwrap(), "{found}");
    let lpips = |found: &Value| found["lpips"].as_array().unwrap().iter().map(|w| w["found"] == true).collect::<Vec<_>>();
    assert_eq!(lpips(&found), [false, false]);
    std::fs::write(folder.path("lpips_alex.safetensors"), "").unwrap();
    assert_eq!(lpips(&serde_json::from_str(&run(Some(folder.0.path()), &["--json"])).unwrap()), [true, false]);
    let text = run(None, &[]);
    for word in ["version", "denoiser", "network", "LPIPS", "RENDERFLOW_LPIPS_WEIGHTS", "core", "memory", "disk"] {
        assert!(text.contains(word), "{word}: {text}");
    }
}

/// Without the variable there are no weights, wherever the program was built.
#[test]
fn scores_have_lpips_only_where_its_weights_are_named() {
    let folder = Folder::new();
    let model = folder.model();
    folder.rendered(&[&model, "--resolution", "48"], "truth");
    let (truth, results) = (folder.at("truth"), folder.at("results"));
    let evaluate = |more: &[&str]| {
        let mut command = Command::new(PROGRAM);
        command.args(["evaluate", &truth, &truth, "-o", &results]).args(more).env_remove("RENDERFLOW_LPIPS_WEIGHTS");
        let output = command.output().unwrap();
        assert!(output.status.success() && stderr(&output).contains("there is no LPIPS"), "{}", stderr(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let table = evaluate(&[]);
    let sets: Value = serde_json::from_str(&evaluate(&["--json"])).unwrap();
    let metrics = sets[0]["rows"][0]["metrics"].as_object().unwrap();
    assert!(metrics.contains_key("psnr") && !metrics.keys().any(|name| name.contains("lpips")), "{metrics:?}");
    assert!(table.contains(sets[0]["rows"][0]["label"].as_str().unwrap()), "{table}");
}

#[cfg(unix)]
#[test]
fn results_are_opened_when_asked() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new();
    let model = folder.model();
    std::fs::create_dir(folder.path("bin")).unwrap();
    for name in ["xdg-open", "open"] {
        let script = folder.path("bin").join(name);
        std::fs::write(&script, format!("#!/bin/sh\nprintf %s \"$1\" >'{0}.new' && mv '{0}.new' '{0}'\n", folder.at("opened")))
            .unwrap();
        std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o755)).unwrap();
    }
    let path = format!("{}:{}", folder.at("bin"), std::env::var("PATH").unwrap());
    let render = |more: &[&str]| {
        let mut command = Command::new(PROGRAM);
        command.args(["render", &model, "--resolution", "16", "--spp", "1", "--denoise", "none", "-o"]).arg(folder.path("out"));
        assert!(command.args(more).env("PATH", &path).status().unwrap().success());
    };
    render(&[]);
    assert!(!folder.path("opened").exists());
    render(&["--open"]);
    // The desktop's program runs by itself.
    for _ in 0..6000 {
        if folder.path("opened").exists() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    assert_eq!(folder.bytes("opened"), folder.at("out/frame.0000.png").as_bytes());
}

fn shipped_weights() -> &'static str {
    concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/fusion.safetensors")
}

#[test]
fn weights_are_told_for_people_and_for_programs() {
    let folder = Folder::new();
    let text = succeed(&["weights"]);
    let header: Value = serde_json::from_str(&succeed(&["weights", "--json"])).unwrap();
    assert!(text.lines().any(|line| line.starts_with("steps ") && line.ends_with(&header["steps"].to_string())), "{text}");
    // The mean of equal weights is the weights.
    let mean = folder.at("mean.safetensors");
    let average = ["weights", "average", shipped_weights(), shipped_weights(), "-o", &mean];
    succeed(&average);
    assert!(folder.bytes("mean.safetensors") == std::fs::read(shipped_weights()).unwrap());
    assert!(fail(&average).contains("is there already"));
    std::fs::remove_file(mean).unwrap();
    // A folder with two files is both.
    for name in ["a.safetensors", "b.safetensors"] {
        std::fs::copy(shipped_weights(), folder.path(name)).unwrap();
    }
    let folder_path = folder.0.path().to_str().unwrap();
    let listed: Value = serde_json::from_str(&succeed(&["weights", "inspect", "--json", folder_path])).unwrap();
    let paths: Vec<&str> = listed.as_array().unwrap().iter().map(|file| file["path"].as_str().unwrap()).collect();
    assert_eq!(paths, [folder.at("a.safetensors"), folder.at("b.safetensors")]);
}

#[test]
fn tables_of_render_and_stress_are_json_when_asked() {
    let folder = Folder::new();
    let scene = ["--seed", "7", "--resolution", "24", "--frames", "1"];
    folder.rendered(&scene, "reference");
    let reference = folder.at("reference/frame.0000.exr");
    let words = [&scene[..], &["--spp", "8", "--reference", &reference, "--json"]].concat();
    for again in [false, true] {
        let output = renderflow(&[&["render", "--denoise", "none", "-o", &folder.at("out")][..], &words].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let said: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(said["frames"].as_array().unwrap().len(), 1);
        assert!(said["frames"][0]["file"].as_str().unwrap().ends_with("frame.0000.exr") && said["frames"][0]["spp"] == 8);
        let rows: Vec<&Value> = said["errors"].as_array().unwrap().iter().filter(|row| row["spp"].is_number()).collect();
        // A stored frame is compared once; a new one each time its samples have doubled.
        assert!(if again { rows.len() == 1 } else { rows.len() >= 3 }, "{said}");
        assert!(rows.iter().all(|row| row["psnr"].as_f64().unwrap() > 0.0 && row["relmse"].as_f64().unwrap() > 0.0));
    }
    let listed: Value = serde_json::from_str(&succeed(&["stress", "--list", "--json"])).unwrap();
    assert!(listed.as_array().unwrap().iter().all(|check| check["name"].is_string() && check["about"].is_string()));
}

#[test]
fn a_plan_takes_no_options_that_change_nothing() {
    let folder = Folder::new();
    let out = folder.at("plan.json");
    let counts = ["dataset", "plan", "--seed", "1", "--sequences", "1", "--frames", "4", "--resolution", "16", "--overwrite"];
    let run = |more: &[&str]| renderflow(&[&counts[..], &["--out", &out], more].concat());
    let idle: [(&str, &[&str]); 8] = [
        ("--distance", &["--compact", "--distance"]),
        ("--adaptive", &["--spp", "0", "--adaptive"]),
        ("--max-bounces", &["--spp", "0", "--max-bounces", "2"]),
        ("--denoise oidn", &["--spp", "0", "--denoise", "oidn"]),
        ("--between-spp", &["--spp", "0", "--between-spp", "4"]),
        ("--keyframe-gap", &["--spp", "0", "--keyframe-gap", "2"]),
        ("--between-spp", &["--between-spp", "4", "--keyframe-gap", "1"]),
        ("--between-spp", &["--between-spp", "4", "--keyframe-gap", "2", "--frame-step", "2"]),
    ];
    for (option, more) in idle {
        let output = run(more);
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{more:?}: {text}");
        assert!(text.contains(&format!("{option}: ")) && text.contains("would change nothing"), "{more:?}: {text}");
        assert!(!folder.path("plan.json").exists(), "{more:?}");
    }
    let useful: [&[&str]; 6] = [
        &["--compact"],
        &["--spp", "0", "--compact"],
        &["--spp", "0", "--between-spp", "0"],
        &["--adaptive", "--max-bounces", "2"],
        &["--between-spp", "4", "--keyframe-gap", "2"],
        &["--distance", "--spp", "1", "--denoise", "none", "--frame-step", "4"],
    ];
    for more in useful {
        let output = run(more);
        assert!(output.status.success(), "{more:?}: {}", stderr(&output));
    }
    // A plan that was edited says so when it is rendered.
    let mut plan = folder.json("plan.json");
    plan["storage"] = "compact".into();
    std::fs::write(folder.path("plan.json"), plan.to_string()).unwrap();
    let output = renderflow(&["dataset", "render", "--plan", &out, "--out", &folder.at("data")]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("plan.json: /render/distance: has no effect: "), "{}", stderr(&output));
}

#[cfg(unix)]
#[test]
fn one_process_at_a_time_renders_into_a_folder() {
    let folder = Folder::new();
    let (model, out) = (folder.model(), folder.at("out"));
    let words = ["render", &model, "--resolution", "16", "--spp", "1", "--denoise", "none", "--out", &out];
    std::fs::create_dir(&out).unwrap();
    // As another process that renders holds it.
    let taken = std::fs::File::open(&out).unwrap();
    taken.lock().unwrap();
    assert!(fail(&words).contains("another process writes to this folder"));
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), 0);
    drop(taken);
    succeed(&words);
    succeed(&words);
}

/// Files have the permissions that the user's umask leaves, as those of any other program.
#[cfg(unix)]
#[test]
fn files_follow_the_umask() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new();
    for (umask, mode) in [("077", 0o600), ("022", 0o644), ("002", 0o664)] {
        let plan = folder.at(&format!("{umask}.toml"));
        let script = format!("umask {umask}; exec \"$0\" dataset plan --seed 1 --sequences 1 -o \"$1\"");
        let output = Command::new("sh").args(["-c", &script, PROGRAM, &plan]).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        assert_eq!(std::fs::metadata(&plan).unwrap().permissions().mode() & 0o777, mode, "{umask}");
    }
}

/// What would have no effect, or no end, is refused before anything is made.
#[test]
fn options_without_effect_are_refused() {
    let folder = Folder::new();
    let out = folder.at("out");
    let misused = |words: &[&str]| {
        let output = renderflow(words);
        assert_eq!(output.status.code(), Some(2), "{words:?}: {}", stderr(&output));
        stderr(&output)
    };
    for frames in ["0", "4000000000"] {
        assert!(misused(&["compose", "--seed", "2", "--frames", frames]).contains("--frames"));
        assert!(misused(&["render", "--seed", "2", "--frames", frames, "-o", &out]).contains("--frames"));
    }
    for budget in [["--time-budget", "1"], ["--target-error", ".01"]] {
        let said = misused(&[&["render", "--seed", "2", "--spp", "3", "-o", &out][..], &budget].concat());
        assert!(said.contains("cannot be used with") && said.contains("--spp"), "{said}");
    }
    for scene in [["--hdri", "nonsense.hdr"], ["--set", "materials/0/roughness=7"], ["--camera", "99"]] {
        let said = fail(&[&["edit", "--resolution", "16", "--steps", "1", "--methods", "ibl", "-o", &out][..], &scene].concat());
        assert!(said.contains("--sweep"), "{said}");
    }
    assert!(!folder.path("out").exists());
}
