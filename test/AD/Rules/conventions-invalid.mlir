// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-make-adjoint
// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-forward-diff

// expected-error @+1 {{'tai.conventions' is a dictionary, but got "split"}}
func.func @no_dictionary(%x: memref<4xf64>) attributes {tai.differentiate, tai.conventions = "split"} {
  return
}

// -----

// expected-error @+1 {{'tai.conventions' has no choice 'ties = 1 : i64'; there are 'ties = "split"', 'arcs = "clamp"' and 'guards = false'}}
func.func @no_string(%x: memref<4xf64>) attributes {tai.differentiate, tai.conventions = {ties = 1}} {
  return
}

// -----

// expected-error @+1 {{'tai.conventions' has no choice 'guards = "off"'}}
func.func @no_boolean(%x: memref<4xf64>) attributes {tai.differentiate, tai.conventions = {guards = "off"}} {
  return
}

// -----

// expected-error @+1 {{'tai.conventions' has no choice 'arcs = "split"'}}
func.func @other_word(%x: memref<4xf64>) attributes {tai.differentiate, tai.conventions = {arcs = "split"}} {
  return
}

// -----

// expected-error @+1 {{'tai.conventions' has no choice 'kinks = "left"'}}
func.func @no_such_choice(%x: memref<4xf64>) attributes {tai.differentiate, tai.conventions = {kinks = "left"}} {
  return
}
