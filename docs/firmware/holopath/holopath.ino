// HoloPath's device on an Arduino-like board (AVR, SAMD, ESP32, Teensy): trigger pulses on a pin, a stepper motor
// with a STEP/DIR driver for the focus, and where there is a display its frames and their lasers.
//
// Nothing here waits: a pulse ends, and a step begins, when loop() next comes by. On slow boards, an Uno say, that may
// be a millisecond or two later while much arrives.

#include <Arduino.h>

#include "protocol.h"

// ---- Your board ----------------------------------------------------------------------------------------------------

const uint32_t BAUD = 115200;  // the same on the computer; boards with USB of their own take any
const char NAME[] = "HoloPath board";

const uint8_t TRIGGER_PIN = 2;
const uint8_t TRIGGER_ON = HIGH;

const uint8_t STEP_PIN = 3, DIRECTION_PIN = 4;
const uint8_t FORWARD = HIGH;           // level of DIRECTION_PIN while the position grows
const uint32_t STEPS_PER_SECOND = 800;  // at most; there is no ramp, so what the motor can start with

const uint8_t LASER_PINS[] = {5, 6, 7};  // by the index of the wavelength; frames switch them
const uint8_t LASER_ON = HIGH;
const uint32_t LASER_TIMEOUT = 5000;  // milliseconds without the computer after which all go off

const uint16_t WIDTH = 0, HEIGHT = 0;  // of the display; 0: none, and no frames are taken
const uint8_t BITS = 8;                // of its pixels

// ---------------------------------------------------------------------------------------------------------------------

#if defined(__AVR__)
const uint16_t LONGEST = 64, WINDOW = 2;  // an Uno has 2 KiB of memory, and 64 bytes wait for loop() at most
#else
const uint16_t LONGEST = 512, WINDOW = 8;
#endif

const uint32_t STEP_INTERVAL = 1000000 / STEPS_PER_SECOND;  // microseconds
const uint32_t SHORTEST_LEVEL = 3;                          // microseconds that drivers and inputs need to see one
const uint32_t PAUSE = 50;                                  // milliseconds

class Board final : public holopath::Handler {
public:
    void setup() {
        set_up(TRIGGER_PIN, !TRIGGER_ON);
        set_up(STEP_PIN, LOW);
        set_up(DIRECTION_PIN, FORWARD);
        for (uint8_t pin : LASER_PINS) set_up(pin, !LASER_ON);
    }

    // Whatever is due.
    void run() {
        const uint32_t now = uint32_t(micros());
        // differences, as micros() begins again at 0 after 71 minutes
        if (pulse_on_ && uint32_t(now - pulse_begin_) >= pulse_length_) end_pulse();
        if (at_ != target_ && uint32_t(now - step_begin_) >= STEP_INTERVAL) {
            step_begin_ = now;
            step();
        }
        if (lit_ && uint32_t(uint32_t(millis()) - heard_) > LASER_TIMEOUT) light(NO_LASER);
    }

    void begin_stream() override { light(NO_LASER); }
    void heard() override { heard_ = uint32_t(millis()); }

    void trigger(uint32_t, uint32_t microseconds) override {
        if (pulse_on_) {  // two pulses are to be seen, not a longer one
            end_pulse();
            delayMicroseconds(SHORTEST_LEVEL);
        }
        digitalWrite(TRIGGER_PIN, TRIGGER_ON);
        pulse_begin_ = uint32_t(micros());
        pulse_length_ = microseconds;
        pulse_on_ = true;
    }

    void focus(int32_t position) override { target_ = position; }
    int32_t position() override { return at_; }
    bool moving() override { return at_ != target_; }

    // ---- Your display: set WIDTH, HEIGHT and BITS above, and fill in these three -----------------------------------

    bool begin(uint32_t, uint16_t, uint16_t, uint8_t, uint8_t, uint32_t) override { return true; }

    void pixels(uint32_t /* offset */, const uint8_t * /* data */, size_t /* n */) override {
        // YOUR DISPLAY: keep these n bytes at `offset` of a frame memory that is not shown yet, e.g.
        // memcpy(back_buffer + offset, data, n). Row by row from the top; two bytes each, low one first, if the frame
        // has more than 8 bits.
    }

    void complete(uint32_t, uint8_t wavelength, bool right) override {
        if (!right) return;
        // YOUR DISPLAY: show that frame memory.
        light(wavelength);
    }

    // -----------------------------------------------------------------------------------------------------------------

    void write(const uint8_t *data, size_t n) override { Serial.write(data, n); }

private:
    // Switch this laser on and the others off.
    void light(uint16_t wavelength) {
        uint16_t index = 0;
        for (uint8_t pin : LASER_PINS) digitalWrite(pin, index++ == wavelength ? LASER_ON : !LASER_ON);
        lit_ = wavelength != NO_LASER;
    }

    static void set_up(uint8_t pin, uint8_t level) {
        digitalWrite(pin, level);
        pinMode(pin, OUTPUT);
        digitalWrite(pin, level);  // some boards take a level only once the pin is an output
    }

    void end_pulse() {
        digitalWrite(TRIGGER_PIN, !TRIGGER_ON);
        pulse_on_ = false;
    }

    void step() {
        const bool forward = target_ > at_;
        digitalWrite(DIRECTION_PIN, forward ? FORWARD : !FORWARD);
        delayMicroseconds(SHORTEST_LEVEL);
        digitalWrite(STEP_PIN, HIGH);
        delayMicroseconds(SHORTEST_LEVEL);
        digitalWrite(STEP_PIN, LOW);
        at_ += forward ? 1 : -1;
    }

    static const uint16_t NO_LASER = 256;
    bool pulse_on_ = false, lit_ = false;
    uint32_t pulse_begin_ = 0, pulse_length_ = 0, step_begin_ = 0, heard_ = 0;
    int32_t at_ = 0, target_ = 0;
};

const uint8_t ABILITIES = holopath::CAN_TRIGGERS | holopath::CAN_FOCUS | (WIDTH && HEIGHT ? holopath::CAN_FRAMES : 0);

Board board;
holopath::Protocol<LONGEST, WINDOW> protocol(board, {WIDTH, HEIGHT, BITS, ABILITIES, NAME});
uint32_t heard = 0;  // milliseconds

void setup() {
    board.setup();
#if defined(ESP32)
    Serial.setRxBufferSize(WINDOW * (LONGEST + 16));  // before begin(); all that may be under way
#endif
    Serial.begin(BAUD);
}

void loop() {
    uint8_t block[32];  // not more at once: pulses and steps are to be on time
    size_t n = 0;
    while (n < sizeof block && Serial.available() > 0) block[n++] = uint8_t(Serial.read());
    if (n) {
        protocol.receive(block, n);
        heard = uint32_t(millis());
    } else {
        protocol.idle();
        if (uint32_t(uint32_t(millis()) - heard) > PAUSE) protocol.pause();
    }
    board.run();
}
