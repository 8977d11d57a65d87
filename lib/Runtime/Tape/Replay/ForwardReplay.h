//===- ForwardReplay.h - Re-execution of recorded sequences -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_REPLAY_FORWARDREPLAY_H
#define TAI_LIB_RUNTIME_TAPE_REPLAY_FORWARDREPLAY_H

#include "../Memory/TapeMemory.h"
#include "../Memory/TapeTopology.h"
#include "../Record/TapeRecording.h"
#include "../TapeServices.h"

namespace mlir::tai::runtime {

/// One replay of all records, on the current contents of fields. Overwritten
/// values are saved for adjoints in the same way as during recording.
class ForwardReplay {
public:
  ForwardReplay(TapeServices services, const TapeRecording &recording,
                TapeMemory &memory, TapeTopology &topology, Launch &launch)
      : services(services), recording(recording), memory(memory),
        topology(topology), launch(launch) {}

  Status run();

private:
  Status replay(size_t index);

  TapeServices services;
  const TapeRecording &recording;
  TapeMemory &memory;
  TapeTopology &topology;
  Launch &launch;
};

/// Re-executes one record, with the same random numbers. `changesMemory`: the
/// record is a host function that changed memory; this fails if the function
/// cannot be called again.
Status replayRecord(const TapeServices &services,
                    const TapeRecording &recording, Launch &launch,
                    size_t index, bool changesMemory);

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_REPLAY_FORWARDREPLAY_H
