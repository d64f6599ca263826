// A device on this computer: docs/firmware/holopath/protocol.h behind a tty, with a display, triggers and a focus that
// takes its time. It writes what took effect to a log, a line each:
//
//     frame NUMBER WIDTH HEIGHT BITS WAVELENGTH CRC    of the pixels as they came, found bit by bit
//     damaged NUMBER                                   a frame whose CRC is not the announced one
//     trigger NUMBER MICROSECONDS
//     focus POSITION
//
// Arguments: tty or number of an open file, WIDTHxHEIGHT, log, and optionally positions a second (1000) and the longest
// payload, 512 or 64. It ends with the tty or by SIGTERM.

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

#include <chrono>
#include <string>
#include <vector>

#include "../../docs/firmware/holopath/protocol.h"

static volatile sig_atomic_t ended = 0;

static void end(int) { ended = 1; }

// Not protocol.h's, which is under test.
static uint32_t slow_crc32(const std::vector<uint8_t> &data) {
    uint32_t crc = 0xFFFFFFFF;
    for (uint8_t byte : data) {
        crc ^= byte;
        for (int bit = 0; bit < 8; ++bit) crc = crc & 1 ? crc >> 1 ^ 0xEDB88320 : crc >> 1;
    }
    return ~crc;
}

class Machine final : public holopath::Handler {
public:
    Machine(int line, FILE *log, double speed) : line_(line), log_(log), speed_(speed) {}

    bool begin(uint32_t, uint16_t width, uint16_t height, uint8_t bits, uint8_t wavelength, uint32_t bytes) override {
        width_ = width, height_ = height, bits_ = bits, wavelength_ = wavelength;
        back_.assign(bytes, 0);
        return true;
    }

    void pixels(uint32_t offset, const uint8_t *data, size_t n) override {
        for (size_t i = 0; i < n; ++i) back_.at(offset + i) = data[i];  // ends the program if it is too much
    }

    void complete(uint32_t number, uint8_t wavelength, bool right) override {
        if (!right) {
            fprintf(log_, "damaged %u\n", unsigned(number));
        } else if (wavelength == wavelength_) {
            fprintf(log_, "frame %u %d %d %d %d %08x\n", unsigned(number), width_, height_, bits_, wavelength_,
                    unsigned(slow_crc32(back_)));
        }
    }

    void trigger(uint32_t number, uint32_t microseconds) override {
        fprintf(log_, "trigger %u %u\n", unsigned(number), unsigned(microseconds));
    }

    void focus(int32_t position) override {
        begin_ = this->position(), target_ = position, left_ = Clock::now();
        fprintf(log_, "focus %d\n", int(position));
    }

    int32_t position() override {
        const double way = double(target_) - begin_;
        const double gone = std::chrono::duration<double>(Clock::now() - left_).count() * speed_;
        if (gone >= (way < 0 ? -way : way)) return target_;
        return begin_ + int32_t(way < 0 ? -gone : gone);
    }

    bool moving() override { return position() != target_; }

    void write(const uint8_t *data, size_t n) override {
        while (n && !ended) {
            const ssize_t written = ::write(line_, data, n);
            if (written < 0) return;  // the computer is gone: reading tells
            data += written;
            n -= size_t(written);
        }
    }

private:
    using Clock = std::chrono::steady_clock;

    int line_;
    FILE *log_;
    double speed_;  // positions a second
    int width_ = 0, height_ = 0, bits_ = 0, wavelength_ = 0;
    std::vector<uint8_t> back_;  // pixels that are not shown yet
    int32_t begin_ = 0, target_ = 0;
    Clock::time_point left_ = Clock::now();
};

static bool readable(int line, int milliseconds) {
    pollfd wait = {line, POLLIN, 0};
    return poll(&wait, 1, milliseconds) > 0;
}

template <uint16_t Longest, uint16_t Window>
static void run(int line, Machine &machine, const holopath::Description &description, int silence) {
    holopath::Protocol<Longest, Window> protocol(machine, description);
    uint8_t block[256];
    while (!ended) {
        if (!readable(line, 0)) {
            protocol.idle();
            if (!readable(line, silence)) {
                protocol.pause();
                continue;
            }
        }
        const ssize_t n = read(line, block, sizeof block);
        if (n <= 0) return;
        protocol.receive(block, size_t(n));
    }
}

int main(int argc, char **argv) {
    int width = 0, height = 0;
    if (argc < 4 || sscanf(argv[2], "%dx%d", &width, &height) != 2) {
        fprintf(stderr, "firmware_host TTY WIDTHxHEIGHT LOG [POSITIONS_A_SECOND [LONGEST [SILENCE]]]\n");
        return 2;
    }
    const bool number = std::string(argv[1]).find_first_not_of("0123456789") == std::string::npos;
    const int line = number ? atoi(argv[1]) : open(argv[1], O_RDWR | O_NOCTTY);
    FILE *log = fopen(argv[3], "a");
    if (line < 0 || !log) {
        perror("firmware_host");
        return 1;
    }
    setvbuf(log, nullptr, _IOLBF, 4096);  // each line is there at once, also if the program is killed
    termios settings;
    if (tcgetattr(line, &settings) == 0) {
        cfmakeraw(&settings);
        tcsetattr(line, TCSANOW, &settings);
    }
    struct sigaction action = {};
    action.sa_handler = end;  // without SA_RESTART: what waits is interrupted
    sigaction(SIGTERM, &action, nullptr);

    Machine machine(line, log, argc > 4 ? atof(argv[4]) : 1000);
    const holopath::Description description = {uint16_t(width), uint16_t(height), 16, 7, "Host"};
    const int silence = argc > 6 ? atoi(argv[6]) : 50;  // milliseconds after which half a packet is given up
    if (argc > 5 && atoi(argv[5]) == 64) {
        run<64, 2>(line, machine, description, silence);
    } else {
        run<512, 8>(line, machine, description, silence);
    }
    fclose(log);
    return 0;
}
