//! `renderflow view` as a browser, and as somebody else, would speak to it.

use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest;
use tungstenite::protocol::Message;
use tungstenite::{Error, WebSocket};

/// The program, which serves a small scene.
struct Viewer {
    child: Child,
    port: u16,
    token: String,
}

impl Viewer {
    fn start(words: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_renderflow"))
            .args(["view", "--seed", "5", "--resolution", "48"])
            .args(words)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let (port, token) = line.trim().strip_prefix("http://127.0.0.1:").unwrap().split_once("/?token=").unwrap();
        Self { child, port: port.parse().unwrap(), token: token.to_owned() }
    }

    /// The answer to a request with these lines at its head.
    fn get(&self, path: &str, head: &[&str]) -> String {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let head = head.iter().map(|line| format!("{line}\r\n")).collect::<String>();
        write!(stream, "GET {path} HTTP/1.1\r\n{head}Connection: close\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    }

    fn host(&self) -> String {
        format!("Host: 127.0.0.1:{}", self.port)
    }

    fn page(&self) -> Page {
        self.page_from(None).unwrap()
    }

    fn page_from(&self, origin: Option<&str>) -> Result<Page, Box<Error>> {
        let mut request =
            format!("ws://127.0.0.1:{}/live?token={}", self.port, self.token).into_client_request().map_err(Box::new)?;
        if let Some(origin) = origin {
            request.headers_mut().insert("Origin", origin.parse().unwrap());
        }
        let stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        match tungstenite::client(request, stream) {
            Ok((socket, _)) => Ok(Page { socket }),
            Err(tungstenite::HandshakeError::Failure(error)) => Err(Box::new(error)),
            Err(error) => panic!("{error}"),
        }
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A page.
struct Page {
    socket: WebSocket<TcpStream>,
}

/// What the program said.
enum Said {
    Text(Value),
    /// Header and picture.
    Picture(Value, image::RgbImage),
}

impl Page {
    fn say(&mut self, message: &Value) {
        self.socket.send(Message::text(message.to_string())).unwrap();
    }

    fn hear(&mut self) -> Said {
        loop {
            match self.socket.read().unwrap() {
                Message::Text(text) => return Said::Text(serde_json::from_str(&text).unwrap()),
                Message::Binary(bytes) => {
                    let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
                    let header: Value = serde_json::from_slice(&bytes[4..4 + length]).unwrap();
                    let picture = image::load_from_memory(&bytes[4 + length..]).unwrap().into_rgb8();
                    self.say(&json!({"type": "shown"}));
                    return Said::Picture(header, picture);
                }
                _ => {}
            }
        }
    }

    fn text(&mut self, kind: &str) -> Value {
        loop {
            if let Said::Text(value) = self.hear()
                && value["type"] == kind
            {
                return value;
            }
        }
    }

    fn picture(&mut self, side: &str, state: u64) -> (Value, image::RgbImage) {
        loop {
            if let Said::Picture(header, picture) = self.hear()
                && header["side"] == side
                && header["state"] == state
            {
                return (header, picture);
            }
        }
    }
}

#[test]
fn others_are_refused() {
    let viewer = Viewer::start(&[]);
    let (token, host) = (viewer.token.clone(), viewer.host());
    let right = format!("/?token={token}");
    let status = |answer: String| answer.split(' ').nth(1).map(str::to_owned).unwrap_or_default();
    let page = viewer.get(&right, &[&host]);
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("default-src 'none'") && page.contains("no-store"), "{page}");
    assert!(!page.contains("/*SCRIPT*/") && !page.contains("/*STYLE*/"));

    assert_eq!(status(viewer.get("/", &[&host])), "403");
    assert_eq!(status(viewer.get(&format!("/?token={}", "0".repeat(32)), &[&host])), "403");
    assert_eq!(status(viewer.get(&format!("/?token={token}0"), &[&host])), "403");
    // A name that somebody else's server made point here.
    assert_eq!(status(viewer.get(&right, &[&format!("Host: evil.example:{}", viewer.port)])), "421");
    assert_eq!(status(viewer.get(&right, &[&host, "Origin: http://evil.example"])), "403");
    for file in ["scene.json", "camera.json", "left.png", "right.png"] {
        assert_eq!(status(viewer.get(&format!("/{file}"), &[&host])), "403", "{file}");
        // Nothing has been shown.
        assert_eq!(status(viewer.get(&format!("/{file}?token={token}"), &[&host])), "404", "{file}");
    }
    for file in ["..%2f..%2fCargo.toml", "Cargo.toml", "a/b"] {
        assert_eq!(status(viewer.get(&format!("/{file}?token={token}"), &[&host])), "404", "{file}");
    }
    assert!(viewer.page_from(Some("http://evil.example")).is_err());
    assert!(viewer.page_from(Some(&format!("http://localhost:{}", viewer.port))).is_ok());
}

#[test]
fn a_page_gets_pictures_that_follow_its_state() {
    let viewer = Viewer::start(&[]);
    let mut page = viewer.page();
    let hello = page.text("hello");
    assert_eq!((hello["resolution"].clone(), hello["frames"].clone()), (json!([48, 48]), json!(1)));
    assert!(hello["methods"].as_array().unwrap().len() >= 10 && !hello["materials"].as_array().unwrap().is_empty());
    let mut state = hello["state"].clone();
    state["type"] = "state".into();
    state["id"] = 1.into();
    state["left"] = "ibl".into();
    state["right"] = "path".into();
    page.say(&state);
    let (left, before) = page.picture("left", 1);
    assert_eq!((before.width(), before.height(), left["done"].clone()), (48, 48, json!(true)));
    // The path-traced picture gets better, and then says how good the others are.
    let mut samples = Vec::new();
    while samples.last().is_none_or(|last| *last < 256) {
        samples.push(page.picture("right", 1).0["samples"].as_u64().unwrap());
    }
    assert!(samples.is_sorted() && samples[0] <= 4, "{samples:?}");
    let psnr = page.text("psnr");
    assert!(psnr["left"].as_f64().unwrap() > 5.0 && psnr["right"].is_null() && psnr["reference"].as_u64().unwrap() >= 256);

    // Another exposure is the same state.
    page.say(&json!({"type": "exposure", "stops": -2.0}));
    let (_, darker) = page.picture("left", 1);
    let sum = |picture: &image::RgbImage| picture.as_raw().iter().map(|v| u64::from(*v)).sum::<u64>();
    assert!(sum(&darker) < sum(&before));
    page.say(&json!({"type": "exposure", "stops": 0.0}));

    // A camera elsewhere shows something else.
    state["id"] = 2.into();
    state["camera"]["eye"][1] = json!(state["camera"]["eye"][1].as_f64().unwrap() + 2.0);
    page.say(&state);
    let (_, after) = page.picture("left", 2);
    assert_ne!(before, after);

    // So does a material.
    state["id"] = 3.into();
    let all = hello["materials"].as_array().unwrap().len();
    let red = json!({"base_color": [1.0, 0.0, 0.0], "metallic": 1.0});
    state["materials"] = (0..all).map(|number| (number.to_string(), red.clone())).collect::<serde_json::Map<_, _>>().into();
    page.say(&state);
    assert_ne!(page.picture("left", 3).1, after);

    // What was saved is the scene that is shown.
    let scene = viewer.get(&format!("/scene.json?token={}", viewer.token), &[&viewer.host()]);
    let saved: Value = serde_json::from_str(scene.split_once("\r\n\r\n").unwrap().1).unwrap();
    assert_eq!(saved["camera"]["poses"][0]["eye"], state["camera"]["eye"]);
    assert!(scene.contains("attachment; filename=\"scene.json\""));

    page.say(&json!({"type": "pick", "x": 0.5, "y": 0.9}));
    assert!(page.text("pick").get("material").is_some());
    page.say(&json!({"type": "home"}));
    assert_eq!(page.text("state")["state"]["camera"], hello["state"]["camera"]);
}

#[test]
fn nonsense_is_answered_and_survived() {
    let viewer = Viewer::start(&[]);
    let mut page = viewer.page();
    let hello = page.text("hello");
    for nonsense in
        ["", "null", "[1, 2]", "{\"type\": \"state\"}", "{\"type\": \"erase\"}", "{\"type\": \"exposure\", \"stops\": \"x\"}"]
    {
        page.socket.send(Message::text(nonsense)).unwrap();
        assert!(page.text("note")["text"].as_str().unwrap().contains("cannot be read"), "{nonsense}");
    }
    page.socket.send(Message::binary(vec![0; 1000])).unwrap();
    let mut state = hello["state"].clone();
    state["type"] = "state".into();
    let bad: [(&str, Value); 7] = [
        ("/resolution/0", json!(0)),
        ("/resolution/1", json!(100_000)),
        ("/camera/vertical_fov", json!(0.0)),
        ("/camera/eye", hello["state"]["camera"]["target"].clone()),
        ("/camera/eye/0", json!(1e300)),
        ("/rays", json!(3)),
        ("/materials", json!({"first": {}})),
    ];
    for (id, (place, value)) in bad.into_iter().enumerate() {
        let mut wrong = state.clone();
        wrong["id"] = (id + 10).into();
        *wrong.pointer_mut(place).unwrap() = value;
        page.say(&wrong);
        assert!(page.text("note")["text"].is_string(), "{place}");
    }
    // A hundred states in a row: the newest counts.
    for id in 100..200 {
        state["id"] = id.into();
        state["rotation"] = json!(id);
        state["moving"] = json!(id < 199);
        page.say(&state);
    }
    page.picture("right", 199);
    // A message beyond all use ends this connection, and no other.
    let _ = page.socket.send(Message::text("x".repeat(3 << 20)));
    let mut again = viewer.page();
    assert_eq!(again.text("hello")["type"], "hello");
}

#[test]
fn the_newest_page_has_the_scene() {
    let viewer = Viewer::start(&[]);
    let mut first = viewer.page();
    first.text("hello");
    let mut second = viewer.page();
    second.text("hello");
    assert!(first.text("end")["text"].as_str().unwrap().contains("another page"));
    assert!(matches!(first.socket.read(), Err(_) | Ok(Message::Close(_))));
    let mut state = second.home();
    state["type"] = "state".into();
    state["id"] = 1.into();
    second.say(&state);
    second.picture("right", 1);
}

/// A page that does not read what it is sent is replaced, and goes while a large picture is still on its way to it.
#[test]
fn a_page_that_goes_late_does_not_stop_the_newer_one() {
    let viewer = Viewer::start(&[]);
    let mut first = viewer.page();
    let mut state = first.text("hello")["state"].clone();
    state["type"] = "state".into();
    state["id"] = 1.into();
    state["split"] = false.into();
    state["right"] = "path".into();
    state["resolution"] = json!([2048, 2048]);
    first.say(&state);
    // Once its first bytes are here, the rest waits for a reader.
    assert_eq!(first.socket.get_ref().peek(&mut [0]).unwrap(), 1);
    std::thread::sleep(Duration::from_millis(500));
    let mut second = viewer.page();
    second.text("hello");
    state["right"] = "ibl".into();
    state["resolution"] = json!([48, 48]);
    second.say(&state);
    let (_, before) = second.picture("right", 1);
    drop(first);
    std::thread::sleep(Duration::from_millis(500));
    second.say(&json!({"type": "exposure", "stops": -2.0}));
    assert_ne!(second.picture("right", 1).1, before);
}

impl Page {
    /// The state of a new page.
    fn home(&mut self) -> Value {
        self.say(&json!({"type": "home"}));
        self.text("state")["state"].clone()
    }
}

/// The exit code of a program that must end within a minute.
fn end(child: &mut Child) -> Option<i32> {
    let started = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status.code();
        }
        if started.elapsed() > Duration::from_secs(60) {
            let _ = child.kill();
            panic!("it still runs");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[cfg(unix)]
#[test]
fn an_interrupt_ends_it_in_order() {
    for busy in [false, true] {
        let mut viewer = Viewer::start(&[]);
        let mut page = viewer.page();
        let mut state = page.text("hello")["state"].clone();
        if busy {
            state["type"] = "state".into();
            state["id"] = 1.into();
            state["resolution"] = json!([512, 512]);
            page.say(&state);
            page.picture("right", 1);
        }
        let sent = Command::new("kill").args(["-INT", &viewer.child.id().to_string()]).status().unwrap();
        assert!(sent.success());
        assert_eq!(end(&mut viewer.child), Some(0));
    }
}

#[cfg(unix)]
#[test]
fn without_a_reader_of_its_address_it_ends() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_renderflow"))
        .args(["view", "--seed", "5", "--resolution", "32"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    assert_eq!(end(&mut child), Some(1));
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert!(said.contains("nobody reads the address"), "{said}");
}

#[test]
fn a_port_that_is_taken_is_named() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let output = Command::new(env!("CARGO_BIN_EXE_renderflow"))
        .args(["view", "--seed", "5", "--resolution", "32", "--port", &port])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains(&port), "{said}");
}
