//! What the page has not yet been sent. A newer picture of a side replaces an older one, so that nothing piles up.

use super::method::Side;
use super::state::{Message, Picture};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Most texts that wait; the oldest are dropped.
const MOST: usize = 64;

/// What waits, and what stands.
#[derive(Default)]
pub struct Outbox {
    waiting: Mutex<Waiting>,
    changed: Notify,
}

#[derive(Default)]
struct Waiting {
    texts: VecDeque<String>,
    pictures: [Option<Arc<Encoded>>; 2],
    /// The newest picture of each side, sent or not.
    newest: [Option<Arc<Encoded>>; 2],
    scene: String,
    camera: String,
}

/// A picture with its header.
pub struct Encoded {
    /// What it is.
    pub header: Picture,
    /// The PNG.
    pub png: Vec<u8>,
}

impl Encoded {
    /// The message for the page: the length of the header, the header, the PNG.
    pub fn message(&self) -> Vec<u8> {
        let header = serde_json::to_vec(&self.header).unwrap_or_default();
        let mut message = Vec::with_capacity(4 + header.len() + self.png.len());
        message.extend((header.len() as u32).to_le_bytes());
        message.extend(header);
        message.extend(&self.png);
        message
    }
}

/// What the page is sent next.
pub enum Outgoing {
    /// Text.
    Text(String),
    /// A picture.
    Picture(Arc<Encoded>),
}

impl Outbox {
    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends a text.
    pub fn text(&self, message: &Message) {
        let mut waiting = self.waiting();
        if waiting.texts.len() >= MOST {
            waiting.texts.pop_front();
        }
        waiting.texts.push_back(serde_json::to_string(message).unwrap_or_default());
        self.changed.notify_one();
    }

    /// Sends a picture.
    pub fn picture(&self, header: Picture, png: Vec<u8>) {
        let side = header.side.index();
        let encoded = Arc::new(Encoded { header, png });
        let mut waiting = self.waiting();
        waiting.newest[side] = Some(Arc::clone(&encoded));
        waiting.pictures[side] = Some(encoded);
        self.changed.notify_one();
    }

    /// Forgets what an earlier page was not sent.
    pub fn clear(&self) {
        let mut waiting = self.waiting();
        waiting.texts.clear();
        waiting.pictures = [None, None];
    }

    /// Keeps the scene and the camera that the page shows, as files.
    pub fn keep(&self, scene: String, camera: String) {
        let mut waiting = self.waiting();
        (waiting.scene, waiting.camera) = (scene, camera);
    }

    /// The scene and the camera that the page shows.
    pub fn kept(&self) -> [String; 2] {
        let waiting = self.waiting();
        [waiting.scene.clone(), waiting.camera.clone()]
    }

    /// The newest picture of a side.
    pub fn newest(&self, side: Side) -> Option<Arc<Encoded>> {
        self.waiting().newest[side.index()].clone()
    }

    /// Waits for what comes next; for pictures only if `pictures`.
    pub async fn next(&self, pictures: bool) -> Outgoing {
        loop {
            if let Some(next) = self.take(pictures) {
                return next;
            }
            self.changed.notified().await;
        }
    }

    fn take(&self, pictures: bool) -> Option<Outgoing> {
        let mut waiting = self.waiting();
        if let Some(text) = waiting.texts.pop_front() {
            return Some(Outgoing::Text(text));
        }
        let side = (0..2).find(|side| pictures && waiting.pictures[*side].is_some())?;
        waiting.pictures[side].take().map(Outgoing::Picture)
    }
}
