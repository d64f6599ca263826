// The device's end of HoloPath's serial protocol, version 1; docs/serial-protocol.md says what is sent and why.
//
// Plain C++11 without heap, exceptions or anything of Arduino's. Give bytes to receive() as they arrive, call idle()
// when there are none left, and pause() when there have been none for 50 ms. What is to be done is told to a Handler.

#ifndef HOLOPATH_PROTOCOL_H
#define HOLOPATH_PROTOCOL_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

namespace holopath {

const uint8_t PROTOCOL_VERSION = 1;

// What a device can do, to be added up.
const uint8_t CAN_FRAMES = 1, CAN_TRIGGERS = 2, CAN_FOCUS = 4;

// What the device is; WELCOME says so.
struct Description {
    uint16_t width, height;  // 0 without a display
    uint8_t bits, can;
    const char *name;  // UTF-8, of which 64 bytes are sent
};

// What the device does. Nothing here may wait: bytes get lost meanwhile.
struct Handler {
    // Pixels will come; false to have none of them. The frame fits the display, and bytes fits its size.
    virtual bool begin(uint32_t number, uint16_t width, uint16_t height, uint8_t bits, uint8_t wavelength,
                       uint32_t bytes) = 0;
    // The next bytes of the frame, in order and never beyond those announced. Not to be shown yet.
    virtual void pixels(uint32_t offset, const uint8_t *data, size_t n) = 0;
    // All have come. Show them if they are the right ones, else nothing.
    virtual void complete(uint32_t number, uint8_t wavelength, bool right) = 0;
    virtual void trigger(uint32_t number, uint32_t microseconds) = 0;
    virtual void focus(int32_t position) = 0;  // set off for it
    virtual int32_t position() = 0;
    virtual bool moving() = 0;
    virtual void write(const uint8_t *data, size_t n) = 0;  // to the computer
    virtual void begin_stream() {}                          // a new one: switch all lasers off
    virtual void heard() {}  // a packet has come; if none does for some seconds, switch them off, too

protected:
    ~Handler() = default;  // not virtual: nobody deletes one, and AVR has no operator delete
};

// CRC-32 of zlib. Goes on from an earlier one. Half a byte at a time: a table for whole ones takes 1 KiB.
inline uint32_t crc32(const uint8_t *data, size_t n, uint32_t crc = 0) {
    static const uint32_t TABLE[16] = {
        0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4, 0x4DB26158, 0x5005713C,
        0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C, 0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C,
    };
    crc = ~crc;
    while (n--) {
        crc ^= *data++;
        crc = TABLE[crc & 15] ^ (crc >> 4);
        crc = TABLE[crc & 15] ^ (crc >> 4);
    }
    return ~crc;
}

// Longest: bytes of payload that are taken. Window: packets that may be under way. A packet waits in Longest + 16
// bytes of memory.
template <uint16_t Longest, uint16_t Window>
class Protocol {
    static_assert(Longest >= 32, "HoloPath sends payloads of 32 bytes at least");
    static_assert(Longest <= 32768, "a packet must not exceed what a 16-bit size_t counts");
    static_assert(Window >= 1, "one packet must be under way");

public:
    Protocol(Handler &handler, const Description &description) : handler_(handler), description_(description) {}

    void receive(uint8_t byte) { receive(&byte, 1); }

    void receive(const uint8_t *data, size_t n) {
        while (n) {
            // never beyond the end of the packet in front, so that the buffer cannot overflow
            const size_t part = n < needed_ - filled_ ? n : needed_ - filled_;
            memcpy(buffer_ + filled_, data, part);
            filled_ += part;
            data += part;
            n -= part;
            if (filled_ == needed_) search(0);
        }
    }

    // Nothing is left to read: tell what was taken.
    void idle() {
        if (news_) report(false);
    }

    // Nothing has come for 50 ms, and the rest of a packet never takes so long: what began was none, or its end is
    // lost. Without this a HELLO would be taken for the end of a long packet that a pulled plug has cut.
    void pause() {
        while (filled_) search(1);
        idle();
    }

private:
    enum : uint8_t {
        Hello = 1, Frame = 2, Part = 3, Trigger = 4, Focus = 5, Status = 6, Welcome = 129, Report = 130
    };
    enum : size_t { Header = 12, Check = 4, WelcomeSize = 22, LongestName = 64 };

    static uint16_t get16(const uint8_t *p) { return uint16_t(p[0] | uint16_t(p[1]) << 8); }
    static uint32_t get32(const uint8_t *p) { return get16(p) | uint32_t(get16(p + 2)) << 16; }
    static uint8_t *put8(uint8_t *p, uint8_t value) { return *p = value, p + 1; }
    static uint8_t *put16(uint8_t *p, uint16_t value) { return put8(put8(p, uint8_t(value)), uint8_t(value >> 8)); }
    static uint8_t *put32(uint8_t *p, uint32_t value) { return put16(put16(p, uint16_t(value)), uint16_t(value >> 16)); }

    // Take the packets in the buffer, of which the first does not begin before `at`.
    void search(size_t at) {
        needed_ = Header;
        for (;; ++at) {  // after what was none, the search goes on at the byte behind its first
            while (at < filled_ && !begins(at)) ++at;
            if (filled_ - at < Header) break;
            const uint8_t *packet = buffer_ + at;
            const size_t n = get16(packet + 6), whole = Header + (n ? n + Check : 0);
            if (n > Longest || get32(packet + 8) != crc32(packet + 2, 6)) continue;
            if (filled_ - at < whole) {
                needed_ = whole;
                break;
            }
            if (n && get32(packet + Header + n) != crc32(packet + Header, n)) continue;
            take(packet[2], packet[3], get16(packet + 4), packet + Header, n);
            at += whole - 1;
        }
        filled_ -= at;
        memmove(buffer_, buffer_ + at, filled_);
    }

    bool begins(size_t at) const {
        return buffer_[at] == 0xA5 && (at + 1 == filled_ || buffer_[at + 1] == 0x5A);
    }

    void take(uint8_t kind, uint8_t session, uint16_t sequence, const uint8_t *payload, size_t n) {
        if (kind != Hello && (!greeted_ || session != session_)) return;  // sent before the last handshake
        handler_.heard();
        if (kind == Hello) {
            hello(session, payload, n);
        } else if (kind == Status) {
            report(false);
        } else if (kind >= Frame && kind <= Focus) {
            if (sequence == expected_) {
                ++expected_;
                news_ = true;
                perform(kind, payload, n);
            } else if (uint16_t(expected_ - sequence) < 0x8000) {
                news_ = true;  // it was taken, but the report is lost
            } else {
                report(true);
            }
        }
    }

    void hello(uint8_t session, const uint8_t *payload, size_t n) {
        if (n && payload[0] != PROTOCOL_VERSION) return welcome(session, false);  // the computer stops then
        if (n != 6) return;
        const uint32_t stream = get32(payload + 2);
        if (!greeted_ || stream != stream_) {
            greeted_ = true;
            stream_ = stream;
            expected_ = 0;
            frames_ = triggers_ = 0;
            receiving_ = goes_on_ = false;
            handler_.begin_stream();
        } else if (session != session_) {
            if (uint8_t(session - session_) >= 128) return;  // has been under way for long
            goes_on_ = true;
        }  // else it asks again, and is told the same: that the stream is new, if it was
        session_ = session;
        news_ = false;
        welcome(session, goes_on_);
    }

    void perform(uint8_t kind, const uint8_t *payload, size_t n) {
        if (kind == Frame) {
            receiving_ = n == 18 && announce(payload);  // also ends one of which not all has come
        } else if (kind == Part) {
            if (n >= 4) part(get32(payload), payload + 4, n - 4);
        } else if (kind == Trigger) {
            if (n != 8) return;
            handler_.trigger(get32(payload), get32(payload + 4));
            ++triggers_;
        } else if (n == 4) {
            handler_.focus(int32_t(get32(payload)));
        }
    }

    // Whether the pixels of this frame are wanted.
    bool announce(const uint8_t *payload) {
        const uint16_t width = get16(payload + 4), height = get16(payload + 6);
        const uint8_t bits = payload[8];
        number_ = get32(payload);
        wavelength_ = payload[9];
        bytes_ = get32(payload + 10);
        right_crc_ = get32(payload + 14);
        had_ = crc_ = 0;
        const uint8_t size = bits > 8 ? 2 : 1;
        return width && height && width <= description_.width && height <= description_.height && bits &&
               bits <= 16 && bytes_ % size == 0 && bytes_ / size == uint32_t(width) * height &&
               handler_.begin(number_, width, height, bits, wavelength_, bytes_);
    }

    void part(uint32_t offset, const uint8_t *data, size_t n) {
        if (!receiving_ || offset != had_ || n > bytes_ - had_) return;
        crc_ = crc32(data, n, crc_);
        handler_.pixels(offset, data, n);
        had_ += uint32_t(n);
        if (had_ < bytes_) return;
        receiving_ = false;
        const bool right = crc_ == right_crc_;
        handler_.complete(number_, wavelength_, right);
        if (right) ++frames_;
    }

    void welcome(uint8_t session, bool goes_on) {
        uint8_t packet[Header + WelcomeSize + LongestName + Check];
        uint8_t *p = put8(put8(packet + Header, PROTOCOL_VERSION), goes_on);
        p = put16(put16(put16(p, Longest), Window), expected_);
        p = put32(put32(p, frames_), uint32_t(handler_.position()));
        p = put16(put16(p, description_.width), description_.height);
        p = put8(put8(p, description_.bits), description_.can);
        for (size_t i = 0; i < LongestName && description_.name[i]; ++i) p = put8(p, uint8_t(description_.name[i]));
        send(packet, Welcome, session, size_t(p - packet) - Header);
    }

    void report(bool again) {
        uint8_t packet[Header + 16 + Check];
        uint8_t *p = put8(put8(put16(packet + Header, expected_), again), handler_.moving());
        put32(put32(put32(p, frames_), triggers_), uint32_t(handler_.position()));
        news_ = false;
        send(packet, Report, session_, 16);
    }

    // The payload is in its place, behind the header.
    void send(uint8_t *packet, uint8_t kind, uint8_t session, size_t n) {
        uint8_t *p = put8(put8(put8(put8(packet, 0xA5), 0x5A), kind), session);
        p = put16(put16(p, 0), uint16_t(n));
        put32(p, crc32(packet + 2, 6));
        put32(packet + Header + n, crc32(packet + Header, n));
        handler_.write(packet, Header + n + Check);
    }

    Handler &handler_;
    const Description description_;

    uint8_t buffer_[Header + Longest + Check];
    size_t filled_ = 0, needed_ = Header;

    bool greeted_ = false, goes_on_ = false, news_ = false;
    uint8_t session_ = 0;
    uint16_t expected_ = 0;
    uint32_t stream_ = 0, frames_ = 0, triggers_ = 0;

    bool receiving_ = false;  // a frame, with:
    uint8_t wavelength_ = 0;
    uint32_t number_ = 0, bytes_ = 0, had_ = 0, crc_ = 0, right_crc_ = 0;
};

}  // namespace holopath

#endif
