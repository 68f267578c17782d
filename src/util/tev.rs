//! Shows pictures in tev (<https://github.com/Tom94/tev>), a viewer of radiance that listens for them.

use anyhow::{Context, Result};
use renderflow_frame::Frame;
use renderflow_frame::image::Rgb;
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use tev_client::{PacketCreateImage, PacketUpdateImage, TevClient};

/// How long a viewer may take to answer, and to take what it is sent.
const PATIENCE: Duration = Duration::from_secs(5);
/// Channels of the picture.
const PICTURE: [&str; 3] = ["R", "G", "B"];
/// Channels that come with a finished frame, in threes.
const LAYERS: [&str; 7] = ["albedo.R", "albedo.G", "albedo.B", "normal.X", "normal.Y", "normal.Z", "depth.Z"];

/// A connection to tev.
pub struct Tev {
    /// `None` once the viewer is gone.
    client: Mutex<Option<TevClient>>,
}

impl Tev {
    /// Connects to the viewer at `address`, HOST:PORT; tev itself listens at 127.0.0.1:14158.
    ///
    /// # Errors
    /// When nobody answers there.
    pub fn connect(address: &str) -> Result<Self> {
        let connect = || -> std::io::Result<TcpStream> {
            let mut last = std::io::Error::from(std::io::ErrorKind::AddrNotAvailable);
            for place in address.to_socket_addrs()? {
                match TcpStream::connect_timeout(&place, PATIENCE) {
                    Ok(stream) => {
                        stream.set_write_timeout(Some(PATIENCE))?;
                        return Ok(stream);
                    }
                    Err(error) => last = error,
                }
            }
            Err(last)
        };
        let stream = connect().with_context(|| format!("--tev {address}: no viewer answers"))?;
        Ok(Self { client: Mutex::new(Some(TevClient::wrap(stream))) })
    }

    /// Opens a picture of this size.
    pub fn create(&self, name: &str, [width, height]: [usize; 2]) {
        let channels: Vec<&str> = PICTURE.into_iter().chain(LAYERS).collect();
        self.send(|client| {
            client.send(PacketCreateImage {
                image_name: name,
                grab_focus: true,
                width: width as u32,
                height: height as u32,
                channel_names: &channels,
            })
        });
    }

    /// Shows the radiance of a picture, so far as it is known.
    pub fn update(&self, name: &str, picture: &Rgb) {
        self.channels(name, &PICTURE, [picture.width, picture.height], picture.pixels.as_flattened());
    }

    /// Shows a finished frame.
    pub fn finish(&self, name: &str, frame: &Frame) {
        let size = [frame.width, frame.height];
        if let Some(picture) = frame.beauty.as_ref().or(frame.raw.as_ref()) {
            self.update(name, picture);
        }
        self.channels(name, &LAYERS[..3], size, frame.albedo.pixels.as_flattened());
        self.channels(name, &LAYERS[3..6], size, frame.normal.pixels.as_flattened());
        self.channels(name, &LAYERS[6..], size, &frame.depth.pixels);
    }

    /// Shows channels whose values follow each other in each pixel.
    fn channels(&self, name: &str, channels: &[&str], [width, height]: [usize; 2], data: &[f32]) {
        if data.is_empty() || data.len() != width * height * channels.len() {
            return;
        }
        let offsets: Vec<u64> = (0..channels.len() as u64).collect();
        let strides = vec![channels.len() as u64; channels.len()];
        self.send(|client| {
            client.send(PacketUpdateImage {
                image_name: name,
                grab_focus: false,
                channel_names: channels,
                channel_offsets: &offsets,
                channel_strides: &strides,
                x: 0,
                y: 0,
                width: width as u32,
                height: height as u32,
                data,
            })
        });
    }

    /// Sends something. A viewer that was closed must not end the render, so its loss is only reported.
    fn send(&self, packet: impl FnOnce(&mut TevClient) -> std::io::Result<()>) {
        let mut client = self.client.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(connected) = client.as_mut()
            && let Err(error) = packet(connected)
        {
            eprintln!("warning: the viewer is gone ({error}); the render goes on without it");
            *client = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;
    use std::net::TcpListener;

    /// The packets of a connection without their lengths, by the description of the protocol in tev's own `Ipc.cpp`: every packet
    /// begins with its length in bytes, little endian, itself included, and a byte that says what it is.
    fn packets(listener: &TcpListener) -> Vec<Vec<u8>> {
        let (mut stream, _) = listener.accept().unwrap();
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        let mut packets = Vec::new();
        while !bytes.is_empty() {
            let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
            packets.push(bytes[4..length].to_vec());
            bytes.drain(..length);
        }
        packets
    }

    #[test]
    fn pictures_arrive_as_the_protocol_says() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let sender = std::thread::spawn(move || {
            let tev = Tev::connect(&address).unwrap();
            tev.create("a", [2, 1]);
            tev.update("a", &Rgb { width: 2, height: 1, pixels: vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]] });
        });
        let packets = packets(&listener);
        sender.join().unwrap();
        assert_eq!(packets.len(), 2);
        let mut create = vec![4, 1, b'a', 0];
        create.extend([2u32, 1, 10].iter().flat_map(|v| v.to_le_bytes()));
        for name in PICTURE.iter().chain(&LAYERS) {
            create.extend(name.bytes().chain([0]));
        }
        assert_eq!(packets[0], create);
        let mut update = vec![6, 0, b'a', 0];
        update.extend(3u32.to_le_bytes());
        update.extend(b"R\0G\0B\0");
        update.extend([0u32, 0, 2, 1].iter().flat_map(|v| v.to_le_bytes()));
        update.extend([0u64, 1, 2, 3, 3, 3].iter().flat_map(|v| v.to_le_bytes()));
        update.extend([1f32, 2.0, 3.0, 4.0, 5.0, 6.0].iter().flat_map(|v| v.to_le_bytes()));
        assert_eq!(packets[1], update);
    }

    #[test]
    fn a_viewer_that_is_not_there_is_named_and_one_that_goes_is_forgotten() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let tev = Tev::connect(&address).unwrap();
        drop(listener.accept().unwrap());
        drop(listener);
        let picture = Rgb::filled(256, 256, [1.0; 3]);
        for _ in 0..200 {
            tev.update("a", &picture);
        }
        assert!(tev.client.lock().unwrap().is_none());
        let said = format!("{:#}", Tev::connect(&address).err().unwrap());
        assert!(said.contains(&address) && said.contains("no viewer"), "{said}");
        assert!(Tev::connect("nonsense").is_err());
    }
}
