use super::*;

/// A reader that gives `step` bytes at a time.
struct Drip<'a>(&'a [u8], usize);

impl Read for Drip<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let n = self.1.min(self.0.len()).min(buffer.len());
        buffer[..n].copy_from_slice(&self.0[..n]);
        self.0 = &self.0[n..];
        Ok(n)
    }
}

/// A picture in structure: a segment with a thumbnail's marks in it, coded data, an end.
fn picture(mark: u8) -> Vec<u8> {
    let mut bytes = vec![0xff, 0xd8, 0xff, 0xe1, 0, 8, 0xff, 0xd8, 0xff, 0xff, 0xd9, mark];
    bytes.extend([0xff, 0xda, 0, 4, 1, 2, mark, 0xff, 0, 9, 0xff, 0xd3, 0xff, 0xff, 0xd9]);
    bytes
}

/// All pictures of `bytes`, which arrive `step` at a time, and how the stream ends.
fn pictures(bytes: &[u8], step: usize) -> (Vec<Vec<u8>>, StreamError) {
    let (mut reader, mut picture, mut all) =
        (Pictures::new(Drip(bytes, step)), Vec::new(), Vec::new());
    loop {
        match reader.next(&mut picture) {
            Ok(()) => all.push(picture.clone()),
            Err(error) => return (all, error),
        }
    }
}

#[test]
fn streams_as_cameras_send_them_however_they_arrive() {
    let (one, two) = (picture(1), picture(2));
    let png = [PNG, b"\0\0\0\x02IDATab1234", b"\0\0\0\0IEND1234"].concat();
    for (form, head, middle) in [
        (
            "with lengths",
            "--f\r\nContent-Length: 27\r\n\r\n",
            "\r\n--f\r\nContent-Length: 27\r\n\r\n",
        ),
        ("lengths too large", "--f\r\nContent-Length: 99\r\n\r\n", "\r\n--f\r\n\r\n"),
        ("lengths too small", "--f\r\nContent-Length: 3\r\n\r\n", "\r\n--f\r\n\r\n"),
        ("other delimiters, bare newlines", "video\n\n", "\nframe\nA:b\n\n"),
        (
            "a status in XML first",
            "--f\r\nContent-Type: text/xml\r\n\r\n<a>\u{ff}</a>\r\n--f\r\n\r\n",
            "--f\r\n\r\n",
        ),
        ("nothing between", "", ""),
    ] {
        let stream =
            [head.as_bytes(), &one, middle.as_bytes(), &two, middle.as_bytes(), &png].concat();
        for step in [1, 2, 7, 1000] {
            let (all, error) = pictures(&stream, step);
            assert_eq!(error, StreamError::Ended, "{form}, {step} at a time");
            assert_eq!(all, [one.clone(), two.clone(), png.clone()], "{form}, {step} at a time");
        }
    }
}

#[test]
fn a_picture_that_breaks_off_costs_itself_alone() {
    let (one, two) = (picture(1), picture(2));
    for cut in 18..one.len() - 1 {
        let stream = [&one[..cut], b"\r\n--f\r\n\r\n", &two, b"\r\n--f\r\n"].concat();
        let (all, _) = pictures(&stream, 11);
        let last = all.last().expect("a picture");
        assert_eq!(last, &two, "cut at {cut}");
        assert!(all.len() == 2 && !is_whole(&all[0]), "cut at {cut}");
    }
}

#[test]
fn what_came_in_place_of_pictures_is_said() {
    for (stream, expected) in [
        ("", "empty"),
        ("<html><title>Login</title>", "HTML page"),
        ("--f\r\nContent-Type: text/xml\r\n\r\n<?xml?><a>busy</a>", "busy"),
        ("--f\r\nContent-Type: image/gif\r\n\r\nGIF89a....", "a GIF picture"),
    ] {
        let (all, error) = pictures(stream.as_bytes(), 5);
        assert!(all.is_empty());
        assert!(error.to_string().contains(expected), "{error}");
    }
}

/// Never ends: what it begins with, then always the same byte.
struct Endless(Vec<u8>, u8);

impl Read for Endless {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let n = self.0.len().min(buffer.len());
        buffer[..n].copy_from_slice(&self.0[..n]);
        self.0.drain(..n);
        buffer[n..].fill(self.1);
        Ok(buffer.len())
    }
}

#[test]
fn memory_is_bounded_whatever_comes() {
    let begun = picture(1)[..20].to_vec();
    for (beginning, byte) in
        [(Vec::new(), b'-'), (begun.clone(), b'x'), (begun, 0xff), (PNG.to_vec(), b'A')]
    {
        let mut reader = Pictures::new(Endless(beginning, byte));
        let mut picture = Vec::new();
        let error = (0..3).find_map(|_| reader.next(&mut picture).err()).expect("no end");
        assert!(matches!(error, StreamError::NoPicture(_) | StreamError::TooLarge), "{error}");
        assert!(reader.buffer.capacity() <= 3 * (MAX_PICTURE_BYTES + CHUNK));
    }
}

/// Processor time of this thread, s.
fn processor_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux");
    let nanoseconds = text.split(' ').next().and_then(|word| word.parse::<f64>().ok());
    nanoseconds.expect("a number") * 1e-9
}

/// Parts that are announced with 8 MB and cut off after some bytes: each byte is looked at once.
#[test]
fn cut_parts_cost_no_more_than_their_bytes() {
    let part = b"--b\r\nContent-Length: 8388608\r\n\r\n\xff\xd8\xff\xe0";
    let time = |megabytes: usize| {
        let stream = part.repeat((megabytes << 20) / part.len());
        let (mut reader, mut picture) = (Pictures::new(stream.as_slice()), Vec::new());
        let begun = processor_s();
        while reader.next(&mut picture).is_ok() {}
        processor_s() - begun
    };
    time(1);
    let (small, large) = (time(1), time(8));
    assert!(large < 24.0 * small + 0.05, "1 MB takes {small:.3} s, 8 MB {large:.3} s");
}

#[test]
fn rubbish_never_panics() {
    let mut rng = fastrand::Rng::with_seed(7);
    let alphabet = b"--f\r\n:\xff\xd8\xff\xd9\xff\xda\xff\xe1\0\x02\0\x89PNG\r\n\x1a\nIEND";
    for _ in 0..5000 {
        let bytes: Vec<u8> =
            (0..rng.usize(..200)).map(|_| alphabet[rng.usize(..alphabet.len())]).collect();
        let step = rng.usize(1..9);
        let (all, _) = pictures(&bytes, step);
        assert!(all.iter().map(Vec::len).sum::<usize>() <= bytes.len());
    }
}
