// Serial-line DAQ on an Arduino Uno: docs/devices/serial-line-daq.md has the wiring. The protocol is in line_daq.h.
// Another board: change the pins and what stands under __AVR__; all counts, and so the calibrations, are its own.
#include "line_daq.h"
#ifdef __AVR__
#include <avr/wdt.h>
#endif

const uint8_t ANALOG[] = {A0, A1, A2};          // a0 pressure, a1 displacement, a2 force; a3 is what o0 holds
const uint8_t STOP = 7;                         // d0: high while the emergency stop is not pressed
const uint8_t REGULATOR = 9;                    // o0: pulses through a filter; 9 is timer 1 on the Uno
const uint8_t DUMP = 4;                         // v0: transistor of the dump valve, which is open without current
const uint8_t READINGS = 4;                     // added up for one count: 0 to 4092 on the Uno
const int32_t FULL = 4095;
int32_t held = 0;

uint32_t now() { return micros(); }
bool level(uint8_t) { return digitalRead(STOP) == HIGH; }
void energise(uint8_t, bool on) { digitalWrite(DUMP, on ? HIGH : LOW); }

int32_t reading(uint8_t input) {
  int32_t sum = input == 3 ? held : 0;
  for (uint8_t i = 0; i < READINGS && input < 3; i++) sum += analogRead(ANALOG[input]);
  return sum;
}

void set(uint8_t, int32_t counts) {
  held = counts;
#ifdef __AVR__
  OCR1A = counts;
  if (counts) TCCR1A |= _BV(COM1A1);
  else TCCR1A &= ~_BV(COM1A1);                  // off for good: a count of 0 would leave one pulse in 4096
#else
  analogWrite(REGULATOR, counts);
#endif
}

void send_line(const char *text, uint8_t length) {
#ifndef __AVR__
  if (Serial.availableForWrite() < length) return;  // over USB: nobody reads; the number of the sample shows the loss
#endif
  Serial.write((const uint8_t *)text, length);
}

const Board BOARD = {"Arduino line DAQ", "1", 4, 1, 1, 1, FULL, 5000, now, reading, level, set, energise, send_line};
LineDaq daq(BOARD);

void setup() {
  pinMode(DUMP, OUTPUT);                        // low from the start: an output wakes up low
  pinMode(REGULATOR, OUTPUT);
#ifdef __AVR__
  TCCR1A = _BV(WGM11);                          // timer 1: 12 bit, 3.9 kHz
  TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS10);
  ICR1 = FULL;
  wdt_enable(WDTO_500MS);                       // the processor restarts, and vents, when this program hangs
#else
  analogReadResolution(12);
  analogWriteResolution(12);
#endif
  Serial.begin(500000);
  daq.vent();
}

void loop() {
#ifdef __AVR__
  wdt_reset();
#endif
  while (Serial.available()) daq.take(Serial.read());
  daq.turn();
}
