// The line protocol of the serial-line DAQ, version 1: docs/devices/serial-line-daq.md. Plain C++, no Arduino call, so
// that a computer can compile and test it. What touches pins stands in the sketch and is handed over as a Board.
#pragma once
#include <stdint.h>
#include <string.h>

static const char HEX_DIGITS[] = "0123456789ABCDEF";
struct Board {
  const char *model, *serial;                   // printable, without comma and star
  uint8_t inputs, levels, outputs, valves;      // how many: at most 6 inputs, 6 levels, 4 outputs, 4 valves
  int32_t full_scale;                           // highest count of an output; 0 is the safe one
  uint32_t shortest;                            // shortest period that all readings and a line fit in [us]
  uint32_t (*micros)();
  int32_t (*read)(uint8_t input);
  bool (*level)(uint8_t number);
  void (*set)(uint8_t output, int32_t counts);
  void (*energise)(uint8_t valve, bool on);
  void (*send)(const char *text, uint8_t length);  // may drop the line, must not wait for a reader
};

class LineDaq {
 public:
  explicit LineDaq(const Board &board) : board_(board) {}

  // Every output to 0, every valve off.
  void vent() {
    for (uint8_t i = 0; i < board_.outputs; i++) board_.set(i, held_[i] = 0);
    for (uint8_t i = 0; i < board_.valves; i++) board_.energise(i, on_[i] = false);
  }

  // One character that came in.
  void take(char c) {
    if (c != '\n') {
      in_[length_] = c;
      if (length_ < sizeof in_ - 1) length_++;  // what is too long has a wrong checksum
      return;
    }
    if (whole()) obey();
    length_ = 0;
  }

  // To be called as often as possible: watches the silence, and samples when it is time.
  void turn() {
    uint32_t now = board_.micros();
    if (armed_ && now - fed_ >= armed_ * 1000UL) {
      vent();
      armed_ = 0, vented_ = true;
    }
    if (!period_ || now - due_ >= 0x80000000UL) return;
    uint32_t late = (now - due_) / period_;     // periods in which nothing was sampled: the number tells
    number_ += late + 1;
    due_ += (late + 1) * period_;
    int32_t counts[6];
    for (uint8_t i = 0; i < board_.inputs; i++) counts[i] = board_.read(i);
    begin('S'), number(number_ - 1), number(now), number(state());
    for (uint8_t i = 0; i < board_.inputs; i++) signed_number(counts[i]);
    end();
  }

  static uint16_t crc(const char *text, uint8_t length) {  // CRC-16/IBM-3740: polynomial 0x1021, start 0xFFFF
    uint16_t sum = 0xFFFF;
    while (length--) {
      sum ^= (uint16_t)(uint8_t)*text++ << 8;
      for (uint8_t bit = 0; bit < 8; bit++) sum = sum & 0x8000 ? (sum << 1) ^ 0x1021 : sum << 1;
    }
    return sum;
  }

 private:
  bool whole() {                                // ends in a star and the right CRC, which are cut off
    if (length_ < 6 || in_[length_ - 5] != '*') return false;
    uint16_t told = 0;
    for (uint8_t i = length_ - 4; i < length_; i++) {
      const char *digit = strchr(HEX_DIGITS, in_[i]);
      if (!in_[i] || !digit) return false;
      told = told << 4 | (digit - HEX_DIGITS);
    }
    length_ -= 5;
    in_[length_] = 0;
    return told == crc(in_, length_);
  }

  bool parse() {                                // letter, then up to three numbers of at most nine digits
    const char *at = in_ + 1;
    for (given_ = 0; *at; given_++) {
      if (given_ == 3 || *at++ != ',') return false;
      const char *first = at;
      for (value_[given_] = 0; *at >= '0' && *at <= '9' && at - first < 9; at++)
        value_[given_] = value_[given_] * 10 + (*at - '0');
      if (at == first) return false;
    }
    return given_ > 0;
  }

  void obey() {
    if (!parse()) return;                       // without a number nobody could tell which question it answers
    uint8_t count = in_[0] == 'W' ? board_.outputs : board_.valves;
    bool of_one = in_[0] == 'W' || in_[0] == 'V';
    if (of_one && (given_ < 2 || value_[1] >= count)) return refuse("range");
    int32_t value = value_[given_ - 1];         // the last number, where there is more than what is asked for
    if (in_[0] == 'I' && given_ == 1) return identify();
    if (in_[0] == 'D' && given_ == 1) return answer(state());
    if (in_[0] == 'G' && given_ == 2) {
      if (value > 10000000) return refuse("range");
      period_ = value && (uint32_t)value < board_.shortest ? board_.shortest : value;
      number_ = 0, due_ = board_.micros();
      return answer(period_);
    }
    if (in_[0] == 'T' && given_ <= 2) {
      if (given_ == 1) return answer(armed_);
      if (value && (value < 50 || value > 1000)) return refuse("range");
      if (!value) vent();                       // nothing stays on that nobody watches
      armed_ = value;
      vented_ = false, fed_ = board_.micros();
      return answer(armed_);
    }
    if (in_[0] == 'F' && given_ == 1) {
      if (!armed_) return refuse(vented_ ? "vented" : "unarmed");
      fed_ = board_.micros();
      return answer(state());
    }
    if (!of_one) return refuse("unknown");
    uint8_t i = value_[1];
    if (given_ == 3) {
      if (value > (in_[0] == 'W' ? board_.full_scale : 1)) return refuse("range");
      if (value && !armed_) return refuse(vented_ ? "vented" : "unarmed");
      if (in_[0] == 'W') board_.set(i, held_[i] = value);
      else board_.energise(i, on_[i] = value);
    }
    answer(in_[0] == 'W' ? held_[i] : on_[i]);
  }

  uint8_t state() {                             // bit 0 armed, bit 1 vented by the watchdog, bit 2 and on the levels
    uint8_t bits = (armed_ ? 1 : 0) | (vented_ ? 2 : 0);
    for (uint8_t i = 0; i < board_.levels; i++) bits |= board_.level(i) ? 4 << i : 0;
    return bits;
  }

  void identify() {
    begin('A');
    number(value_[0]);
    word("line-daq"), number(1), word(board_.model), word(board_.serial);
    number(board_.inputs), number(board_.levels), number(board_.outputs), number(board_.valves);
    number(board_.full_scale), number(board_.shortest);
    end();
  }
  void answer(uint32_t value) { begin('A'); number(value_[0]); number(value); end(); }
  void refuse(const char *why) { begin('E'); number(value_[0]); word(why); end(); }

  void begin(char letter) { out_[0] = letter; filled_ = 1; }
  void put(char c) { if (filled_ < sizeof out_ - 6) out_[filled_++] = c; }
  void word(const char *text) { put(','); while (*text) put(*text++); }
  void number(uint32_t value) { put(','); digits(value); }
  void signed_number(int32_t value) {
    word(value < 0 ? "-" : "");
    digits(value < 0 ? 0 - (uint32_t)value : value);
  }
  void digits(uint32_t value) {
    char text[10];
    uint8_t n = 0;
    do text[n++] = '0' + value % 10; while (value /= 10);
    while (n) put(text[--n]);
  }
  void end() {
    uint16_t sum = crc(out_, filled_);
    out_[filled_++] = '*';
    for (int8_t shift = 12; shift >= 0; shift -= 4) out_[filled_++] = HEX_DIGITS[sum >> shift & 15];
    out_[filled_++] = '\n';
    board_.send(out_, filled_);
  }

  const Board &board_;
  char in_[48], out_[120];
  uint8_t length_ = 0, filled_ = 0, given_ = 0;
  bool vented_ = false;
  int32_t value_[3] = {}, held_[4] = {};
  bool on_[4] = {};
  uint32_t period_ = 0, due_ = 0, number_ = 0, fed_ = 0, armed_ = 0;
};
