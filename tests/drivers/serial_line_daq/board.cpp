// The sketch's protocol code on a computer: the same line_daq.h, behind an open file descriptor instead of pins.
// board FD BOOT_MICROS STALL: a0 shows output 0, a1 counts the readings, a2 is the lowest count of 32 bits; level 0 is high,
// level 1 shows valve 0. STALL: every 50th reading takes so long [us].
#include <poll.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

#include "line_daq.h"

static int wire;
static uint32_t boot, readings, stall;
static int32_t held;
static bool on;

static uint32_t now() {
  timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  static const uint64_t start = t.tv_sec * 1000000ULL + t.tv_nsec / 1000;
  return boot + uint32_t(t.tv_sec * 1000000ULL + t.tv_nsec / 1000 - start);
}
static int32_t read_input(uint8_t i) {
  if (i == 1 && stall && readings % 50 == 49) usleep(stall);
  return i == 0 ? held : i == 1 ? int32_t(readings++) : INT32_MIN;
}
static bool level(uint8_t i) { return i == 0 || on; }
static void set(uint8_t, int32_t counts) { held = counts; }
static void energise(uint8_t, bool how) { on = how; }
static void send_line(const char *text, uint8_t n) {
  if (write(wire, text, n) < 0) exit(0);
}

int main(int, char **argv) {
  wire = atoi(argv[1]);
  boot = uint32_t(strtoul(argv[2], nullptr, 10));
  stall = uint32_t(atoi(argv[3]));
  now();
  const Board board = {"emulated compiled sketch", "7", 3, 2, 1, 1, 4095, 2000, now, read_input, level, set, energise, send_line};
  LineDaq daq(board);
  daq.vent();
  for (;;) {
    pollfd waiting = {wire, POLLIN, 0};
    if (poll(&waiting, 1, 1) > 0) {
      char text[256];
      ssize_t n = read(wire, text, sizeof text);
      if (n <= 0) return 0;
      for (ssize_t i = 0; i < n; i++) daq.take(text[i]);
    }
    daq.turn();
  }
}
