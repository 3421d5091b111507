//! The cameras on the network: snapshots, a stream of pictures, and video.
//!
//! Half of what they send is right, so that what is wrong meets a program in full work: pictures
//! of 12 megapixels and of 4K, in all that their shape lets through, and pictures whose metadata
//! unpacks to gigabytes.

use super::fake_broker::{FakeBroker, Manners};
use super::video::video;
use super::{
    SIZE, Watched, camera_sections, common, duration, http, is_long, mutate, pictures, table,
};
use fastrand::Rng;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::{Arc, LazyLock};
use std::time::{Duration, Instant};

/// Most memory that the daemon may take, MB.
const BOUND_MB: f64 = 128.0;

/// Bytes of cameras, whole and in pieces.
pub struct Pictures {
    right: Vec<Vec<u8>>,
    odd: Vec<Vec<u8>>,
}

impl Pictures {
    /// Made once for all tests: pictures of this size take their time.
    pub fn shared() -> &'static Self {
        static PICTURES: LazyLock<Pictures> = LazyLock::new(Pictures::new);
        &PICTURES
    }

    fn new() -> Self {
        let (width, height) = SIZE;
        let large = if is_long() { 4 } else { 1 };
        let large: Vec<_> = (0..large).map(|n| common::jpeg(width, height, 40 * n)).collect();
        // 12 megapixels and more, in the same shape.
        let largest = common::jpeg(5328, 2997, 90);
        let turned = |orientation| with_exif(&largest, orientation);
        let mut right = vec![turned(3), turned(1), png(image::ColorType::Rgb8, SIZE)];
        right.push(png(image::ColorType::Rgba16, SIZE));
        right.push(png(image::ColorType::L8, (5328, 2997)));
        right.push(grey_jpeg(5328, 2997));
        right.extend(large);
        let mut odd = pictures::pictures_to_begin_with();
        let bytes = if is_long() { 1 << 30 } else { 64 << 20 };
        let packed = packed_zeros(bytes);
        for kind in [*b"iCCP", *b"zTXt", *b"iTXt"] {
            odd.push(with_chunk(&png(image::ColorType::Rgb8, (64, 36)), kind, &packed));
        }
        odd.extend(right[2..].iter().cloned());
        Self { right, odd }
    }

    /// A right picture, a wrong one, or something between.
    pub fn any(&self, rng: &mut Rng) -> Vec<u8> {
        match rng.u8(..4) {
            0 | 1 => {
                let mut picture = self.right[rng.usize(..self.right.len())].clone();
                // Another one each time: behind the end marker of neither format.
                let at = picture.len() - 20;
                if rng.bool() {
                    picture[at] ^= rng.u8(..);
                }
                picture
            }
            2 => self.odd[rng.usize(..self.odd.len())].clone(),
            _ => {
                let all = if rng.bool() { &self.odd } else { &self.right };
                let mut bytes = mutate::mutated(rng, all, pictures::WORDS, 9 << 20);
                if bytes.starts_with(b"\x89PNG") {
                    pictures::mend_chunks(rng, &mut bytes);
                }
                bytes
            }
        }
    }
}

fn png(color: image::ColorType, (width, height): (u32, u32)) -> Vec<u8> {
    let bytes = vec![0x55; (width * height) as usize * usize::from(color.bytes_per_pixel())];
    let mut png = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new_with_quality(
        &mut png,
        image::codecs::png::CompressionType::Fast,
        image::codecs::png::FilterType::NoFilter,
    );
    image::ImageEncoder::write_image(encoder, &bytes, width, height, color.into())
        .expect("encoding to memory");
    png
}

fn grey_jpeg(width: u32, height: u32) -> Vec<u8> {
    let picture =
        image::GrayImage::from_fn(width, height, |u, v| image::Luma([(u ^ v) as u8 & 64]));
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new(&mut bytes).encode_image(&picture).expect("to memory");
    bytes
}

/// The JPEG with an EXIF segment that says how it is to be turned.
fn with_exif(jpeg: &[u8], orientation: u8) -> Vec<u8> {
    let mut exif =
        b"\xff\xe1\0\x22Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
    exif.extend([orientation, 0, 0, 0, 0, 0, 0]);
    [&jpeg[..2], &exif, &jpeg[2..]].concat()
}

/// So many zeros as zlib packs them.
fn packed_zeros(bytes: usize) -> Vec<u8> {
    let mut packer = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    (0..bytes >> 20).for_each(|_| packer.write_all(&[0; 1 << 20]).expect("to memory"));
    packer.finish().expect("to memory")
}

/// The PNG with a chunk of metadata behind its header.
fn with_chunk(png: &[u8], kind: [u8; 4], packed: &[u8]) -> Vec<u8> {
    let words: &[u8] = if kind == *b"iTXt" { b"a\0\x01\0\0\0" } else { b"a\0\0" };
    let body = [&kind, words, packed].concat();
    let length = (body.len() - 4) as u32;
    let sum = crate::CRC.checksum(&body);
    [&png[..33], &length.to_be_bytes(), &body, &sum.to_be_bytes(), &png[33..]].concat()
}

/// A server whose every connection is `serve`'s; its threads end with the program.
pub fn serve(
    serve: impl Fn(&mut TcpStream, &mut Rng) -> io::Result<()> + Send + Sync + 'static,
) -> u16 {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    let port = listener.local_addr().expect("its address").port();
    let serve = Arc::new(serve);
    std::thread::spawn(move || {
        for (number, stream) in (0..).zip(listener.incoming().map_while(Result::ok)) {
            let (mut stream, serve) = (stream, Arc::clone(&serve));
            std::thread::spawn(move || {
                let mut rng = Rng::with_seed(number);
                let _ = stream.set_write_timeout(Some(Duration::from_secs(20)));
                let _ = serve(&mut stream, &mut rng);
            });
        }
    });
    port
}

/// Sends in pieces, now and then so slowly that the client's patience ends.
pub fn send(stream: &mut TcpStream, rng: &mut Rng, bytes: &[u8]) -> io::Result<()> {
    match rng.u8(..40) {
        0 => {
            for byte in bytes.iter().take(60) {
                stream.write_all(&[*byte])?;
                std::thread::sleep(Duration::from_millis(200));
            }
            Ok(())
        }
        1 => stream.write_all(&bytes[..rng.usize(..=bytes.len())]),
        _ => stream.write_all(bytes),
    }
}

/// An answer around a picture: right, packed, in chunks, without an end, or wrong.
fn answer(rng: &mut Rng, picture: &[u8]) -> Vec<u8> {
    let plain =
        |lines: &str| [format!("HTTP/1.1 200 OK\r\n{lines}\r\n").as_bytes(), picture].concat();
    let length = picture.len();
    match rng.u8(..12) {
        0 => plain(""),
        1 => plain(&format!("Content-Length: {}\r\n", length * 3)),
        2 => plain(&format!("Content-Length: {}\r\n", length / 2)),
        3 => {
            let size = rng.usize(1..70_000);
            let mut bytes = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n".to_vec();
            for chunk in picture.chunks(size) {
                bytes.extend(format!("{:x}\r\n", chunk.len()).as_bytes());
                bytes.extend(chunk);
                bytes.extend(b"\r\n");
            }
            [&bytes[..], b"0\r\n\r\n"].concat()
        }
        4 => {
            let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
            // Sometimes far more than a picture may have.
            let times = if rng.u8(..4) == 0 { 40 } else { 1 };
            (0..times).for_each(|_| packer.write_all(picture).expect("to memory"));
            let packed = packer.finish().expect("to memory");
            [b"HTTP/1.1 200 OK\r\nContent-Encoding: gzip\r\n\r\n", &packed[..]].concat()
        }
        5 => {
            let long = "x".repeat(rng.usize(..200_000));
            plain(&format!("Set-Cookie: {long}\r\nContent-Length: {length}\r\n"))
        }
        6 => {
            let corpus = http::answers_to_begin_with();
            let mut bytes = mutate::mutated(rng, &corpus, http::TOKENS, 1 << 16);
            http::without_redirects(&mut bytes);
            bytes
        }
        7 => b"HTTP/1.1 302 Found\r\nLocation: /again\r\n\r\n".to_vec(),
        _ => plain(&format!("Content-Type: image/jpeg\r\nContent-Length: {length}\r\n")),
    }
}

fn snapshots(pictures: &'static Pictures) -> String {
    let port = serve(move |stream, rng| {
        let mut request = BufReader::new(stream.try_clone()?);
        loop {
            let mut line = String::new();
            while line != "\r\n" {
                line.clear();
                if request.read_line(&mut line)? == 0 {
                    return Ok(());
                }
            }
            let picture = pictures.any(rng);
            let bytes = answer(rng, &picture);
            send(stream, rng, &bytes)?;
            if rng.bool() {
                return Ok(());
            }
        }
    });
    format!("http://127.0.0.1:{port}/picture")
}

/// Five parts a second, and floods of a second now and then.
fn stream(pictures: &'static Pictures) -> String {
    let port = serve(move |stream, rng| {
        let _ = stream.read(&mut [0; 4096])?;
        stream.write_all(
            b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=b\r\n\r\n",
        )?;
        loop {
            let picture = pictures.any(rng);
            let length = match rng.u8(..8) {
                0 => 8 << 20,
                1 => usize::MAX,
                2 => picture.len() / 2,
                _ => picture.len(),
            };
            match rng.u8(..6) {
                0 => write!(stream, "--b\r\nContent-Type: image/jpeg\r\n\r\n")?,
                _ => write!(stream, "--b\r\nContent-Length: {length}\r\n\r\n")?,
            }
            send(stream, rng, &picture)?;
            stream.write_all(b"\r\n")?;
            if rng.u8(..60) == 0 {
                let begun = Instant::now();
                let part = b"--b\r\nContent-Length: 8388608\r\n\r\n\xff\xd8\xff";
                while begun.elapsed() < Duration::from_millis(200) {
                    stream.write_all(part)?;
                }
            }
            if rng.u8(..40) == 0 {
                return Ok(());
            }
            std::thread::sleep(Duration::from_millis(200));
        }
    });
    format!("mjpeg+http://127.0.0.1:{port}/stream")
}

#[test]
fn a_camera_may_send_anything() {
    let (folder, pictures) = (common::folder(), Pictures::shared());
    let table = table(folder.path());
    let sources =
        [("snapshots", snapshots(pictures)), ("a stream", stream(pictures)), ("video", video())];
    std::thread::scope(|scope| {
        for (what, source) in sources {
            let table = &table;
            scope.spawn(move || {
                let broker = FakeBroker::start(Manners::default());
                let sections = camera_sections(table, &source, 1.0, broker.port);
                let mut daemon = Watched::start(what, &sections, |_| ());
                daemon.wait_for(&broker);
                daemon.watch(BOUND_MB, |_| ());
                // Windows close whatever the camera does: six of ten seconds, one of a minute.
                let least = duration().as_secs() as usize / 60 * 6;
                assert!(broker.windows() >= least, "{what}: {} windows", broker.windows());
            });
        }
    });
}
