// RUN: tai-opt %s --tai-guard-divisions --split-input-file --verify-diagnostics

tai.kernel @zero(%a: i32) -> i32 {
  %c0 = arith.constant 0 : i32
  // expected-error @+1 {{a whole number is divided by zero}}
  %0 = arith.divsi %a, %c0 : i32
  tai.return %0 : i32
}

// -----

tai.kernel @remainder(%a: vector<2xi64>) -> vector<2xi64> {
  %c0 = arith.constant dense<0> : vector<2xi64>
  // expected-error @+1 {{a whole number is divided by zero}}
  %0 = arith.remui %a, %c0 : vector<2xi64>
  tai.return %0 : vector<2xi64>
}

// -----

tai.kernel @overflow() -> i8 {
  %c0 = arith.constant -128 : i8
  %c1 = arith.constant -1 : i8
  // expected-error @+1 {{the smallest i8 is divided by -1, and has no negative}}
  %0 = arith.floordivsi %c0, %c1 : i8
  tai.return %0 : i8
}
