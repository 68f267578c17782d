//! The page and its connection. Only this computer can reach them, and only with the token of the address.

use super::inbox::Inbox;
use super::method::Side;
use super::outbox::{Outbox, Outgoing};
use super::session::Session;
use super::stage::Stage;
use super::state::{Message as Said, Request};
use crate::util::cancel::Cancel;
use anyhow::{Context, Result, anyhow};
use axum::Router;
use axum::body::Body;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use rand::RngExt;
use serde::Deserialize;
use std::net::Ipv4Addr;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::{Notify, watch};

/// The page, with places for its style and its script.
const PAGE: &str = include_str!("page.html");
const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

/// What the page may do: nothing but run its own script, show pictures that it got, and speak to this program.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src blob: data:; \
    connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Largest message from the page, bytes.
const LARGEST: usize = 1 << 20;
/// How often the program looks whether it should end.
const LOOK: Duration = Duration::from_millis(100);

/// What the handlers share.
struct Shared {
    inbox: Arc<Inbox>,
    outbox: Arc<Outbox>,
    token: String,
    port: u16,
    /// The number of the newest connection. Older ones end.
    newest: watch::Sender<u64>,
}

#[derive(Deserialize)]
struct Asked {
    #[serde(default)]
    token: String,
}

/// Serves the page until `cancel` is set; see [`super::serve`].
///
/// # Errors
/// When the port cannot be used, or `opened` fails.
pub fn serve(stage: Stage, port: u16, opened: &dyn Fn(&str) -> Result<()>, cancel: &Cancel) -> Result<()> {
    let (inbox, outbox) = (Arc::new(Inbox::default()), Arc::new(Outbox::default()));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("cannot start the server")?;
    let listener = runtime
        .block_on(TcpListener::bind((Ipv4Addr::LOCALHOST, port)))
        .with_context(|| format!("port {port} of this computer cannot be used"))?;
    let port = listener.local_addr().context("the port has no number")?.port();
    let mut random = rand::rng();
    let token: String = (0..32).map(|_| char::from(b"0123456789abcdef"[random.random_range(0..16)])).collect();
    let shared = Arc::new(Shared {
        inbox: Arc::clone(&inbox),
        outbox: Arc::clone(&outbox),
        token: token.clone(),
        port,
        newest: watch::Sender::new(0),
    });
    let pages = Router::new()
        .route("/", get(page))
        .route("/live", get(live))
        .route("/{file}", get(download))
        .with_state(Arc::clone(&shared));
    std::thread::scope(|scope| {
        let session = Session::new(stage, &inbox, &outbox);
        let ended = Arc::new(Notify::new());
        let tells = Ended(Arc::clone(&ended));
        scope.spawn(move || {
            // However the session ends, the server learns of it.
            let _tells = tells;
            session.run();
        });
        let served = opened(&format!("http://127.0.0.1:{port}/?token={token}")).and_then(|()| {
            runtime.block_on(async {
                tokio::select! {
                    served = async { axum::serve(listener, pages).await } => served.context("the server ended"),
                    () = ended.notified() => Err(anyhow!("the renderer ended")),
                    () = stopped(cancel) => Ok(()),
                }
            })
        });
        inbox.stop();
        served
    })
}

/// Tells the server when it is dropped.
struct Ended(Arc<Notify>);

impl Drop for Ended {
    fn drop(&mut self) {
        self.0.notify_one();
    }
}

async fn stopped(cancel: &Cancel) {
    while !cancel.is_set() {
        tokio::time::sleep(LOOK).await;
    }
}

impl Shared {
    /// Refuses those who do not know the token, and pages of other sites that make the browser ask.
    fn admit(&self, headers: &HeaderMap, token: &str) -> Result<(), StatusCode> {
        // Browsers leave out the port that is usual.
        let own = |host: &str| {
            let name = host.strip_suffix(&format!(":{}", self.port)).or((self.port == 80).then_some(host));
            name.is_some_and(|name| ["127.0.0.1", "localhost"].contains(&name))
        };
        let text = |name| headers.get(name).map(|value: &HeaderValue| value.to_str().unwrap_or("-"));
        if !text(header::HOST).is_some_and(own) {
            return Err(StatusCode::MISDIRECTED_REQUEST);
        }
        if text(header::ORIGIN).is_some_and(|origin| !origin.strip_prefix("http://").is_some_and(own)) {
            return Err(StatusCode::FORBIDDEN);
        }
        // Every byte is compared, so that the time says nothing about how many are right.
        let same = token.len() == self.token.len()
            && token.bytes().zip(self.token.bytes()).fold(0, |differ, (a, b)| differ | (a ^ b)) == 0;
        if same { Ok(()) } else { Err(StatusCode::FORBIDDEN) }
    }
}

/// A response that no other site can use.
fn guarded(kind: &'static str, body: impl Into<Body>) -> Response {
    let headers = [
        (header::CONTENT_TYPE, kind),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::CACHE_CONTROL, "no-store"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ];
    (headers, body.into()).into_response()
}

async fn page(State(shared): State<Arc<Shared>>, headers: HeaderMap, Query(asked): Query<Asked>) -> Response {
    if let Err(status) = shared.admit(&headers, &asked.token) {
        return (status, "Open the address that the program printed, with its token.\n").into_response();
    }
    let page = PAGE.replace("/*STYLE*/", STYLE).replace("/*SCRIPT*/", SCRIPT);
    guarded("text/html; charset=utf-8", page)
}

async fn download(
    State(shared): State<Arc<Shared>>,
    headers: HeaderMap,
    Path(file): Path<String>,
    Query(asked): Query<Asked>,
) -> Response {
    if let Err(status) = shared.admit(&headers, &asked.token) {
        return status.into_response();
    }
    let [scene, camera] = shared.outbox.kept();
    let picture = |side| shared.outbox.newest(side).map(|picture| ("image/png", picture.png.clone()));
    let found = match &file[..] {
        "scene.json" => Some(("application/json", scene.into_bytes())),
        "camera.json" => Some(("application/json", camera.into_bytes())),
        "left.png" => picture(Side::Left),
        "right.png" => picture(Side::Right),
        _ => None,
    };
    match found.filter(|(_, bytes)| !bytes.is_empty()) {
        None => StatusCode::NOT_FOUND.into_response(),
        Some((kind, bytes)) => {
            let mut response = guarded(kind, bytes);
            if let Ok(name) = HeaderValue::from_str(&format!("attachment; filename=\"{file}\"")) {
                response.headers_mut().insert(header::CONTENT_DISPOSITION, name);
            }
            response
        }
    }
}

async fn live(
    State(shared): State<Arc<Shared>>,
    headers: HeaderMap,
    Query(asked): Query<Asked>,
    upgrade: WebSocketUpgrade,
) -> Response {
    if let Err(status) = shared.admit(&headers, &asked.token) {
        return status.into_response();
    }
    upgrade.max_message_size(LARGEST).on_upgrade(move |socket| converse(socket, shared))
}

/// Waits for a connection newer than `number`.
async fn replaced(newest: &mut watch::Receiver<u64>, number: u64) {
    // The sender lives as long as the server.
    drop(newest.wait_for(|newest| *newest != number).await);
}

/// Speaks to a page until it goes or another one comes.
async fn converse(mut socket: WebSocket, shared: Arc<Shared>) {
    let mut number = 0;
    shared.newest.send_modify(|newest| {
        *newest += 1;
        number = *newest;
    });
    let mut newest = shared.newest.subscribe();
    shared.inbox.join();
    // A page that was replaced may go late, while a picture is still on its way to it. The newer page stays.
    let leave = || {
        if *shared.newest.borrow() == number {
            shared.inbox.leave();
        }
    };
    let mut drawing = false;
    loop {
        tokio::select! {
            biased;
            () = replaced(&mut newest, number) => {
                let end = Said::End { text: "another page shows the scene now".into() };
                let text = serde_json::to_string(&end).unwrap_or_default();
                // A page that is gone need not be told.
                let _ = socket.send(Message::Text(text.into())).await;
                return;
            }
            received = socket.recv() => match received {
                None | Some(Err(_)) | Some(Ok(Message::Close(_))) => {
                    leave();
                    return;
                }
                Some(Ok(Message::Text(text))) => match serde_json::from_str(&text) {
                    Ok(Request::Shown) => drawing = false,
                    Ok(request) => shared.inbox.put(request),
                    Err(error) => shared.outbox.text(&Said::Note { text: format!("the page sent what cannot be read: {error}") }),
                },
                Some(Ok(_)) => {}
            },
            outgoing = shared.outbox.next(!drawing) => {
                let message = match outgoing {
                    Outgoing::Text(text) => Message::Text(text.into()),
                    Outgoing::Picture(picture) => {
                        drawing = true;
                        Message::Binary(picture.message().into())
                    }
                };
                if socket.send(message).await.is_err() {
                    leave();
                    return;
                }
            }
        }
    }
}
